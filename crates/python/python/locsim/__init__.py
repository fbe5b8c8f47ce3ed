"""A laboratory for particle-filter localization with planar range sensors.

Lengths are in metres, angles in radians, times in seconds. Poses are (x, y, theta) of the robot in the map: x forward,
y left, counter-clockwise positive. Ranges and densities are float32, poses float64; anything that `numpy.asarray` takes
is taken. A range equal to the sensor's maximum means "no return", NaN "no usable reading".
"""

from locsim import distreg
from locsim._locsim import (
    Annealing,
    Answer,
    Beams,
    Estimate,
    Filter,
    FilterError,
    KldSampling,
    LocsimError,
    Log,
    LogError,
    Map,
    Run,
    Scenario,
    ScenarioError,
    SensorError,
    SensorModel,
    Table,
    Update,
    __version__,
    gap,
    read_log,
    run,
    simulate,
)

__all__ = [
    "Annealing",
    "Answer",
    "Beams",
    "Estimate",
    "Filter",
    "FilterError",
    "KldSampling",
    "LocsimError",
    "Log",
    "LogError",
    "Map",
    "Run",
    "Scenario",
    "ScenarioError",
    "SensorError",
    "SensorModel",
    "Table",
    "Update",
    "__version__",
    "distreg",
    "gap",
    "read_log",
    "run",
    "simulate",
]
