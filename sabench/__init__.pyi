from . import (
    algorithms as algorithms,
)
from . import (
    api as api,
)
from . import (
    evaluation as evaluation,
)
from . import (
    geometry as geometry,
)
from . import (
    images as images,
)
from . import (
    metrics as metrics,
)
from . import (
    plotting as plotting,
)
from . import (
    tasks as tasks,
)
from .api.truth import Bubbles as Bubbles
from .api.truth import Particles as Particles
from .dataset.import_recording import (
    ImportOptions as ImportOptions,
)
from .dataset.import_recording import (
    import_recording as import_recording,
)
from .dataset.reader import Dataset as Dataset
from .dataset.reader import open_dataset as open_dataset
from .dataset.results import Result as Result
from .dataset.results import open_result as open_result
from .dataset.sample_set import SampleSet as SampleSet
from .dataset.sample_set import open_samples as open_samples
from .dataset.splits import split_of as split_of
from .dataset.verification import verify as verify
from .evaluation.gates.comparison import check as check
from .evaluation.leaderboard.submissions import submit as submit
from .evaluation.runner import run_suite as run_suite
from .evaluation.thesis import reproduce as reproduce
from .evaluation.viewer.view import View as View
from .evaluation.viewer.view import view as view
from .geometry.camera import Camera as Camera
from .geometry.grid import Grid as Grid
from .geometry.refraction import Layer as Layer
from .geometry.refraction import Wall as Wall
from .interop.cameras import read_camera_source as read_camera_source
from .interop.export import export as export
from .plugins import (
    list_generators as list_generators,
)
from .plugins import (
    list_scenes as list_scenes,
)
from .plugins import (
    list_solvers as list_solvers,
)
from .plugins import (
    list_suites as list_suites,
)
from .scenes import Scene as Scene
from .scenes import load_scene as load_scene
from .simulation.in_memory import simulate as simulate
from .simulation.pipeline import generate as generate
from .simulation.sample_shards import generate_samples as generate_samples
from .simulation.streaming import stream as stream
from .simulation.streaming import stream_key as stream_key
from .tasks.own_calibration import calibrate as calibrate
from .tasks.quality import quality as quality
from .tasks.solve_and_score import score as score
from .tasks.solve_and_score import solve as solve
from .utils.version import __version__ as __version__
