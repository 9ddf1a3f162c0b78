from . import (
    algorithms as algorithms,
    api as api,
    evaluation as evaluation,
    geometry as geometry,
    images as images,
    metrics as metrics,
    plotting as plotting,
    tasks as tasks,
)
from .api.truth import Bubbles as Bubbles, Particles as Particles
from .apps.own_calibration.calibrate import calibrate as calibrate
from .apps.planning.plan import plan as plan
from .apps.viewer.view import View as View, view as view
from .dataset.import_recording import (
    ImportOptions as ImportOptions,
    import_recording as import_recording,
)
from .dataset.reader import Dataset as Dataset, open_dataset as open_dataset
from .dataset.results import Result as Result, open_result as open_result
from .dataset.sample_set import SampleSet as SampleSet, open_samples as open_samples
from .dataset.shards import split_of as split_of
from .dataset.verification import verify as verify
from .evaluation.gates.comparison import check as check
from .evaluation.leaderboard.submissions import submit as submit
from .evaluation.reproduction import reproduce as reproduce
from .evaluation.runner import run_suite as run_suite
from .geometry.camera import Camera as Camera
from .geometry.grid import Grid as Grid
from .geometry.refraction import Layer as Layer, Wall as Wall
from .interop.cameras import read_camera_source as read_camera_source
from .interop.export import export as export
from .plugins import (
    list_generators as list_generators,
    list_scenes as list_scenes,
    list_solvers as list_solvers,
    list_suites as list_suites,
)
from .scenes import Scene as Scene, load_scene as load_scene
from .simulation.in_memory import simulate as simulate
from .simulation.pipeline import generate as generate
from .simulation.sample_shards import generate_samples as generate_samples
from .simulation.shard_job import stream as stream, stream_key as stream_key
from .tasks.quality import quality as quality
from .tasks.solve_and_score import score as score, solve as solve
from .utils.version import __version__ as __version__
