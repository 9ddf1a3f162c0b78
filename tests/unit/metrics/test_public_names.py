"""Public names of the metrics. Each can be imported, and listing them imports no heavy library."""

import subprocess
import sys

import pytest

from sabench import metrics


@pytest.mark.parametrize("name", dir(metrics))
def test_a_public_name_is_a_documented_function(name: str) -> None:
    function = getattr(metrics, name)
    assert function.__name__ == name
    assert function.__doc__


def test_listing_the_names_imports_no_heavy_library() -> None:
    code = "import sys, sabench.metrics as m; assert 'quality' in dir(m); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"numba", "numpy", "scipy"} & set(done.stdout.split())
