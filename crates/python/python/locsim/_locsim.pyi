from collections.abc import Iterable, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, ClassVar, TypeAlias, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

_Path: TypeAlias = str | PathLike[str]
_Keys: TypeAlias = dict[str, Any]
_Source: TypeAlias = "Scenario | _Path | _Keys"

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
    "Prediction",
    "Regression",
    "Run",
    "Scenario",
    "ScenarioError",
    "SensorError",
    "SensorModel",
    "Table",
    "Update",
    "__version__",
    "fit",
    "gap",
    "main",
    "read_log",
    "risk",
    "run",
    "simulate",
]

__version__: str

class LocsimError(Exception): ...

class ScenarioError(LocsimError):
    file: Path
    line: int | None
    key: str
    problems: list[tuple[int | None, str, str]]

class LogError(LocsimError): ...
class SensorError(LocsimError): ...
class FilterError(LocsimError): ...

@final
class Scenario:
    def __new__(
        cls,
        source: _Path | _Keys,
        *,
        base: _Path | None = None,
        trials: int | None = None,
        seed: int | None = None,
        models: Sequence[str] | None = None,
    ) -> Scenario: ...
    def replace(
        self,
        values: _Keys,
        *,
        trials: int | None = None,
        seed: int | None = None,
        models: Sequence[str] | None = None,
    ) -> Scenario: ...
    def to_dict(self) -> _Keys: ...
    @property
    def name(self) -> str: ...
    @property
    def description(self) -> str: ...
    @property
    def file(self) -> Path | None: ...
    @property
    def seed(self) -> int: ...
    @property
    def trials(self) -> int: ...
    @property
    def models(self) -> list[str]: ...

@final
class Table:
    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object: ...
    @property
    def column_names(self) -> list[str]: ...
    @property
    def num_rows(self) -> int: ...
    def __len__(self) -> int: ...

@final
class Run:
    @property
    def tables(self) -> dict[str, Table]: ...
    @property
    def summary(self) -> dict[str, Any]: ...
    @property
    def ratios(self) -> dict[str, dict[str, dict[str, float | None] | None]]: ...
    @property
    def missed(self) -> list[str]: ...
    @property
    def out(self) -> Path | None: ...

def run(
    source: _Source,
    out: _Path | None = None,
    *,
    trials: int | None = None,
    seed: int | None = None,
    models: Sequence[str] | None = None,
    resume: bool = False,
    force: bool = False,
    threads: int | None = None,
    progress: bool | None = None,
) -> Run: ...
@final
class Log:
    @property
    def stamps(self) -> NDArray[np.float64]: ...
    @property
    def poses(self) -> NDArray[np.float64]: ...
    @property
    def laser_poses(self) -> NDArray[np.float64]: ...
    @property
    def odometry(self) -> NDArray[np.float64]: ...
    @property
    def increments(self) -> NDArray[np.float64]: ...
    @property
    def ranges(self) -> NDArray[np.float32]: ...
    @property
    def bearings(self) -> NDArray[np.float32]: ...
    @property
    def beam_times(self) -> NDArray[np.float32]: ...
    @property
    def min_range(self) -> float: ...
    @property
    def max_range(self) -> float: ...
    @property
    def mount(self) -> tuple[float, float, float]: ...
    @property
    def summary(self) -> str: ...
    def with_beams(self, count: int) -> Log: ...
    def save(self, path: _Path) -> None: ...
    def __len__(self) -> int: ...

def read_log(
    path: _Path,
    *,
    max_range_m: float | None = None,
    scan_topic: str | None = None,
    odometry_topic: str | None = None,
    reference_topic: str | None = None,
    without_odometry: bool = False,
) -> Log: ...
def simulate(source: _Source, *, trial: int = 0, seed: int | None = None) -> Log: ...
@final
class Map:
    def __new__(cls, source: _Path | _Keys) -> Map: ...
    @staticmethod
    def load(path: _Path) -> Map: ...
    @property
    def bounds(self) -> list[float]: ...
    @property
    def walls(self) -> NDArray[np.float64]: ...
    def is_free(self, points: ArrayLike) -> NDArray[np.bool_]: ...
    def distance(self, points: ArrayLike) -> NDArray[np.float32]: ...
    def free_poses(self, count: int, *, seed: int = 0) -> NDArray[np.float64]: ...
    def cast(
        self, poses: ArrayLike, bearings: ArrayLike, *, max_range: float | None = None
    ) -> NDArray[np.float32]: ...
    def beams(self, poses: ArrayLike, bearings: ArrayLike, max_range: float) -> Beams: ...

@final
class Beams:
    @staticmethod
    def of_states(ranges: ArrayLike, incidences: ArrayLike, max_range: float) -> Beams: ...
    @property
    def ranges(self) -> NDArray[np.float32]: ...
    @property
    def incidences(self) -> NDArray[np.float32]: ...
    @property
    def surfaces(self) -> NDArray[np.uint32]: ...
    @property
    def max_range(self) -> float: ...
    @property
    def shape(self) -> list[int]: ...

@final
class SensorModel:
    NAMES: ClassVar[list[str]]
    @staticmethod
    def fit(
        name: str, readings: ArrayLike, beams: Beams, *, held_out_share: float = ..., seed: int = 0
    ) -> SensorModel: ...
    @staticmethod
    def load(path: _Path, map: Map | None = None) -> SensorModel: ...
    def save(self, path: _Path) -> None: ...
    @property
    def name(self) -> str: ...
    @property
    def max_range(self) -> float: ...
    @property
    def is_normalized(self) -> bool: ...
    @property
    def chosen(self) -> dict[str, float]: ...
    def log_density(self, readings: ArrayLike, beams: Beams) -> NDArray[np.float32]: ...
    def cdf(self, readings: ArrayLike, beams: Beams) -> NDArray[np.float32]: ...
    def sample(self, beams: Beams, *, seed: int = 0) -> NDArray[np.float32]: ...
    def evaluate(self, readings: ArrayLike, beams: Beams) -> tuple[float, float]: ...
    def choose_tempering(
        self, readings: ArrayLike, poses: ArrayLike, bearings: ArrayLike, map: Map, *, seed: int = 0
    ) -> tuple[float, float]: ...

@final
class Update:
    @property
    def log_evidence(self) -> float: ...
    @property
    def recovered(self) -> bool: ...

@final
class Estimate:
    @property
    def pose(self) -> NDArray[np.float64]: ...
    @property
    def covariance(self) -> NDArray[np.float64]: ...
    @property
    def max_weight(self) -> NDArray[np.float64]: ...

@final
class KldSampling:
    def __new__(
        cls,
        min: int,
        max: int,
        *,
        error: float = 0.05,
        quantile: float = 0.99,
        bin_m: float = 0.5,
        bin_rad: float = ...,
    ) -> KldSampling: ...

@final
class Annealing:
    def __new__(
        cls,
        *,
        candidates: int = 20_000,
        effective_share: float = 0.5,
        moves: int = 4,
        sigma_m: float = 0.01,
        sigma_rad: float = 0.005,
        gathered_m: float = 0.2,
    ) -> Annealing: ...

@final
class Filter:
    def __new__(
        cls,
        map: Map,
        model: SensorModel,
        bearings: ArrayLike,
        *,
        particles: int | KldSampling = ...,
        start: ArrayLike | None = None,
        start_sigma: tuple[float, float] = ...,
        alpha: Sequence[float] = ...,
        random_walk: float = 0.0,
        mount: tuple[float, float, float] = ...,
        tempering: tuple[float, float] = ...,
        resampler: str = "systematic",
        injection: tuple[float, float] | None = None,
        regularization: tuple[float, float] | None = None,
        least_effective_share: float | None = None,
        annealing: Annealing | None = None,
        table: bool = True,
        seed: int = 0,
    ) -> Filter: ...
    def predict(self, odometry: ArrayLike) -> None: ...
    def update(self, ranges: ArrayLike) -> Update: ...
    def resample(self, *, below: float | None = None) -> bool: ...
    def estimate(self) -> Estimate: ...
    # Read-only views; each keeps the values of its moment when the filter goes on.
    @property
    def x(self) -> NDArray[np.float64]: ...
    @property
    def y(self) -> NDArray[np.float64]: ...
    @property
    def theta(self) -> NDArray[np.float64]: ...
    # A copy.
    @property
    def particles(self) -> NDArray[np.float64]: ...
    # Views, too.
    @property
    def weights(self) -> NDArray[np.float64]: ...
    @property
    def log_likelihood(self) -> NDArray[np.float64]: ...
    @property
    def effective_sample_size(self) -> float: ...

@final
class Answer:
    @property
    def text(self) -> str: ...
    @property
    def verdict(self) -> str: ...
    @property
    def effects(self) -> list[dict[str, Any]]: ...
    @property
    def scenario(self) -> str: ...
    @property
    def out(self) -> Path | None: ...
    def to_dict(self) -> dict[str, Any]: ...

def gap(
    source: _Source,
    log: _Path | None = None,
    out: _Path | None = None,
    *,
    baseline: _Path | None = None,
    replicates: int | None = None,
    seed: int | None = None,
    scans: int = 600,
    beams: int = 72,
    without: Sequence[str] | None = None,
    filter: bool = True,
    max_range_m: float | None = None,
    scan_topic: str | None = None,
    odometry_topic: str | None = None,
    reference_topic: str | None = None,
    force: bool = False,
    threads: int | None = None,
    progress: bool | None = None,
) -> Answer: ...
@final
class Regression:
    def predict(self, queries: ArrayLike) -> Prediction: ...
    def losses(
        self,
        states: ArrayLike,
        observations: ArrayLike | Sequence[ArrayLike],
        *,
        loss: str = "crps",
        floor: float = 0.001,
    ) -> NDArray[np.float64]: ...

@final
class Prediction:
    @property
    def centres(self) -> NDArray[np.float64]: ...
    @property
    def mass(self) -> NDArray[np.float64]: ...
    @property
    def point_mass(self) -> NDArray[np.float64]: ...
    @property
    def in_data(self) -> NDArray[np.bool_]: ...
    def density(self, z: ArrayLike) -> NDArray[np.float64]: ...
    def cdf(self, z: ArrayLike) -> NDArray[np.float64]: ...
    def quantile(self, u: ArrayLike) -> NDArray[np.float64]: ...
    def mean(self) -> NDArray[np.float64]: ...
    def __len__(self) -> int: ...

def fit(
    states: ArrayLike,
    observations: ArrayLike | Sequence[ArrayLike],
    *,
    method: str = "np_reg",
    values: tuple[float, float, float],
    point_mass: float | None = None,
    bandwidths: Sequence[float] | None = None,
    neighbours: int | None = None,
    scales: Sequence[float] | None = None,
    kernel: str = "gaussian",
    shift_by: int | None = None,
    scale_by: int | None = None,
    degree: str | None = None,
    smoothing: float | None = None,
    family: str = "gaussian",
    least_observations: int = ...,
    quantiles: int = ...,
) -> Regression: ...
def risk(losses: ArrayLike, *, seed: int = 0) -> tuple[float, float, float]: ...
def main(arguments: Iterable[_Path]) -> int: ...
