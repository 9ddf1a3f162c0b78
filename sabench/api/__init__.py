"""Public types of plug-ins: base classes, observations, estimates and truth.

A solver needs nothing else from sabench, unless it builds on `sabench.algorithms`.
"""

from sabench.api.estimates import Calibration, Detections, FoundParticles, Reconstruction, Velocity
from sabench.api.generators import (
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
from sabench.api.observations import CalibrationCase, Film, Observation, Shown, VolumePair
from sabench.api.parameters import FileParameters, Parameters, PlugIn
from sabench.api.solvers import (
    AnySolver,
    BubbleSolver,
    CalibrationSolver,
    ParticleSolver,
    SeeThroughSolver,
    SelfCalibrationSolver,
    Solver,
    Track,
    VelocimetryParameters,
    VelocimetrySolver,
)
from sabench.api.truth import Bubbles, Particles, Solid, Target
from sabench.geometry.camera import Camera
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.frames import Domain, Pose
from sabench.geometry.grid import Grid
from sabench.geometry.refraction import Layer, Rays, Wall
from sabench.utils.arrays import F32, F64, I32, I64, U16, Bool
from sabench.utils.errors import DeclinedError, InputError
from sabench.utils.fields import Vector
from sabench.utils.rng import stream

__all__ = [
    "F32",
    "F64",
    "I32",
    "I64",
    "U16",
    "AnySolver",
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
    "Domain",
    "FileParameters",
    "Film",
    "Flow",
    "FoundParticles",
    "Generator",
    "Grid",
    "InputError",
    "Layer",
    "Material",
    "Observation",
    "Parameters",
    "ParticleSolver",
    "Particles",
    "PlugIn",
    "Pose",
    "Rays",
    "Reconstruction",
    "SeeThroughSolver",
    "SelfCalibrationSolver",
    "Shown",
    "Solid",
    "SolidGenerator",
    "SolidParameters",
    "Solver",
    "Target",
    "TargetGenerator",
    "Track",
    "Vector",
    "VelocimetryParameters",
    "VelocimetrySolver",
    "Velocity",
    "VolumePair",
    "Wall",
    "stream",
]
