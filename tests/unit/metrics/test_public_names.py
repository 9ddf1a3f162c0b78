"""Public names of the metrics can be imported."""

import pytest

from sabench import metrics


@pytest.mark.parametrize("name", dir(metrics))
def test_a_public_name_is_a_documented_function(name: str) -> None:
    function = getattr(metrics, name)
    assert function.__name__ == name
    assert function.__doc__
