"""Public interface for plug-ins: base classes, data, cameras and helpers.

It holds everything that a plug-in needs besides its algorithm. A plug-in imports from `sabench.api`
and `sabench.algorithms` only (adapters of other programs also from `sabench.interop`, generators
also from `sabench.worlds.library`); anything that these two do not name may move.
"""

from sabench.api.estimates import (
    Calibration as Calibration,
    Detections as Detections,
    FoundParticles as FoundParticles,
    Reconstruction as Reconstruction,
    Velocity as Velocity,
)
from sabench.api.generators import (
    BodyFlow as BodyFlow,
    BubbleGenerator as BubbleGenerator,
    BubbleParameters as BubbleParameters,
    Code as Code,
    CodeGenerator as CodeGenerator,
    Flow as Flow,
    Generator as Generator,
    Material as Material,
    SolidGenerator as SolidGenerator,
    SolidParameters as SolidParameters,
    TargetGenerator as TargetGenerator,
)
from sabench.api.make import make_algorithm as make_algorithm, make_solver as make_solver
from sabench.api.observations import (
    CalibrationCase as CalibrationCase,
    ImagePair as ImagePair,
    ImageSequence as ImageSequence,
    Observation as Observation,
    Shown as Shown,
    VolumePair as VolumePair,
)
from sabench.api.parameters import (
    FileParameters as FileParameters,
    Parameters as Parameters,
    PlugIn as PlugIn,
)
from sabench.api.solvers import (
    AnySolver as AnySolver,
    BubbleSolver as BubbleSolver,
    CalibrationSolver as CalibrationSolver,
    IterativeSolver as IterativeSolver,
    ParticleSolver as ParticleSolver,
    PlanarVelocimetrySolver as PlanarVelocimetrySolver,
    SeeThroughSolver as SeeThroughSolver,
    SelfCalibrationSolver as SelfCalibrationSolver,
    SequenceSolver as SequenceSolver,
    Solver as Solver,
    TaskName as TaskName,
    VelocimetryParameters as VelocimetryParameters,
    VelocimetrySolver as VelocimetrySolver,
)
from sabench.api.truth import (
    Bubbles as Bubbles,
    Particles as Particles,
    Solid as Solid,
    Target as Target,
)
from sabench.geometry.camera import Camera as Camera
from sabench.geometry.camera_model import CameraModel as CameraModel
from sabench.geometry.grid import Grid as Grid
from sabench.geometry.lens import Distortion as Distortion
from sabench.geometry.refraction import Layer as Layer, Rays as Rays, Wall as Wall
from sabench.geometry.rigid_motion import (
    Domain as Domain,
    Pose as Pose,
    frame_along as frame_along,
    rotation_matrices as rotation_matrices,
)
from sabench.geometry.surfaces import bend as bend
from sabench.images.flaws import Flaws as Flaws, Repaired as Repaired
from sabench.utils.arrays import (
    F32 as F32,
    F64 as F64,
    I32 as I32,
    I64 as I64,
    U16 as U16,
    Bool as Bool,
    triple as triple,
)
from sabench.utils.errors import DeclinedError as DeclinedError, InputError as InputError
from sabench.utils.progress import progress_bar as progress_bar
from sabench.utils.rng import stream as stream
from sabench.utils.validation import (
    Direction as Direction,
    LensNumber as LensNumber,
    Vector as Vector,
)
