"""The solver obeys the laws of sabench, and its scores are not worse than before."""


def test_it_obeys_the_laws(sabench_conform):
    sabench_conform("mine")


def test_its_scores_are_not_worse(sabench_check):
    sabench_check("suite.toml", "baseline.json", solvers=["mine"])
