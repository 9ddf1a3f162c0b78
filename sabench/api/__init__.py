"""Public interface for plug-ins: base classes, data, cameras and helpers.

It holds everything that a plug-in needs besides its algorithm. A plug-in imports from `sabench.api`
and `sabench.algorithms` only (adapters of other programs also from `sabench.interop`, generators
also from `sabench.worlds.library`); anything that these two do not name may move.
"""

from sabench.api.estimates import Calibration, Detections, FoundParticles, Reconstruction, Velocity
from sabench.api.generators import (
    BodyFlow,
    BubbleGenerator,
    BubbleParameters,
    Code,
    CodeGenerator,
    Flow,
    Generator,
    Material,
    SolidGenerator,
    SolidParameters,
    TargetGenerator,
)
from sabench.api.make import make_algorithm, make_solver
from sabench.api.observations import (
    CalibrationCase,
    ImagePair,
    ImageSequence,
    Observation,
    Shown,
    VolumePair,
)
from sabench.api.parameters import FileParameters, Parameters, PlugIn
from sabench.api.solvers import (
    AnySolver,
    BubbleSolver,
    CalibrationSolver,
    IterativeSolver,
    ParticleSolver,
    PlanarVelocimetrySolver,
    SeeThroughSolver,
    SelfCalibrationSolver,
    SequenceSolver,
    Solver,
    TaskName,
    VelocimetryParameters,
    VelocimetrySolver,
)
from sabench.api.truth import Bubbles, Particles, Solid, Target
from sabench.geometry.camera import Camera
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.grid import Grid
from sabench.geometry.lens import Distortion
from sabench.geometry.refraction import Layer, Rays, Wall
from sabench.geometry.rigid_motion import Domain, Pose, frame_along, rotation_matrices
from sabench.geometry.surfaces import bend
from sabench.images.flaws import Flaws, Repaired
from sabench.utils.arrays import F32, F64, I32, I64, U16, Bool, triple
from sabench.utils.errors import DeclinedError, InputError
from sabench.utils.progress import progress_bar
from sabench.utils.rng import stream
from sabench.utils.validation import Direction, LensNumber, Vector

__all__ = [
    "F32",
    "F64",
    "I32",
    "I64",
    "U16",
    "AnySolver",
    "BodyFlow",
    "Bool",
    "BubbleGenerator",
    "BubbleParameters",
    "BubbleSolver",
    "Bubbles",
    "Calibration",
    "CalibrationCase",
    "CalibrationSolver",
    "Camera",
    "CameraModel",
    "Code",
    "CodeGenerator",
    "DeclinedError",
    "Detections",
    "Direction",
    "Distortion",
    "Domain",
    "FileParameters",
    "Flaws",
    "Flow",
    "FoundParticles",
    "Generator",
    "Grid",
    "ImagePair",
    "ImageSequence",
    "InputError",
    "IterativeSolver",
    "Layer",
    "LensNumber",
    "Material",
    "Observation",
    "Parameters",
    "ParticleSolver",
    "Particles",
    "PlanarVelocimetrySolver",
    "PlugIn",
    "Pose",
    "Rays",
    "Reconstruction",
    "Repaired",
    "SeeThroughSolver",
    "SelfCalibrationSolver",
    "SequenceSolver",
    "Shown",
    "Solid",
    "SolidGenerator",
    "SolidParameters",
    "Solver",
    "Target",
    "TargetGenerator",
    "TaskName",
    "Vector",
    "VelocimetryParameters",
    "VelocimetrySolver",
    "Velocity",
    "VolumePair",
    "Wall",
    "bend",
    "frame_along",
    "make_algorithm",
    "make_solver",
    "progress_bar",
    "rotation_matrices",
    "stream",
    "triple",
]
