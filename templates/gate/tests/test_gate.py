"""The scores of the suite are not worse than in the baseline."""


def test_scores_are_not_worse(sabench_check):
    sabench_check("suite.toml", "baseline.json")
