"""The types of a client's arguments and results.

Lengths are in mm and coefficients in 1/mm. In the shapes of arrays, C is the number of channels
(media) and N the number of radii.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any, NamedTuple

import numpy as np


class Medium(NamedTuple):
    """A homogeneous, semi-infinite medium."""

    sigma_a: float  # 1/mm: absorption coefficient, 0 to 1e15
    sigma_s: float  # 1/mm: scattering coefficient, 0 to 1e15
    g: float = 0.0  # mean cosine of the phase function, between -1 and 1
    eta: float = 1.3  # index of refraction inside over that outside, 0.001 to 1000


class Grid(NamedTuple):
    """`count` radii from start_mm to stop_mm, both included. Neighbours have the same difference
    (spacing "linear") or the same ratio ("logarithmic")."""

    start_mm: float
    stop_mm: float
    count: int
    spacing: str = "linear"


@dataclass(frozen=True, eq=False)
class Query:
    """A description of what to evaluate. A client's calls take either a Query or its arguments:
    client.eval("better", skin, [0.5, 1.0]) is client.eval(Query("better", skin, [0.5, 1.0])).

    model: a name or an id. With None, the daemon takes the cheapest model and evaluator that are
        measured to be within `tolerance` of radiative transport, for all media and from the
        smallest to the largest radius. The result names both. The daemon refuses the query if it
        knows no model that is accurate enough.
    media: one Medium, several of them, or an array [C, 4] of sigma_a, sigma_s, g and eta.
    r: N radii in mm, from 0 to infinity.
    grid: the radii by a rule, in place of r. The request then lists no radii.
    evaluator: "f64" computes in double precision and "f32" in single precision. "lut" looks values
        up in a table in single precision. If a model is named, the default is "f64". If the model
        is None, the evaluator only says the precision, and the default is single precision.
    moments: how Fresnel reflection is integrated: "exact", or "fit" by published polynomials.
    wanted: names of quantities. The default is R, albedo, cdf and, with a grid, r.
    parameters: optional numbers by name, for example {"cos_in": 0.8}. Their units and ranges are in
        info.choices["parameter"]. The value of fit_model may also be the name of a model. The
        daemon refuses a parameter that the model does not have.
    tolerance: the parameter "tolerance", a relative error. If the model is None, it limits the
        deviation from transport. If a model is named, it limits the numerical error; for "lut",
        the daemon builds the table to this error.
    deadline_ms: how long the answer may take from the arrival of the query; 0 means no limit.
    """

    model: str | int | None
    media: Medium | Iterable[Sequence[float]] | np.ndarray
    r: Any = None
    _: KW_ONLY
    grid: Grid | None = None
    evaluator: str | int | None = None
    moments: str | int = "exact"
    wanted: Iterable[str] | None = None
    parameters: Mapping[str, float | str] | None = None
    tolerance: float | None = None
    deadline_ms: int = 0

    @classmethod
    def of(cls, *arguments: Any, **options: Any) -> Query:
        """Returns the only argument if that is a Query, else the Query with these arguments."""
        first = arguments[0] if arguments else options.get("model")
        if isinstance(first, Query) and len(arguments) + len(options) == 1:
            return first
        return cls(*arguments, **options)


class Choice(NamedTuple):
    """One entry of the daemon's lists: a model, an evaluator, a status and so on."""

    id: int
    name: str
    about: str  # source of a model, unit of a quantity, or meaning


@dataclass(frozen=True)
class Info:
    """A daemon's description of itself: its reply to hello."""

    address: str
    software: str
    instruction_set: str
    R_unit: str
    protocol_version: int
    workers: int
    choices: dict[str, dict[str, Choice]]  # by kind and name: choices["model"]["better"]
    limits: dict[str, int]  # by name; a name ends in the unit, for example max_frame_bytes


class Offer(NamedTuple):
    """A model and an evaluator that could answer a query, with their error and their cost."""

    model: str
    evaluator: str
    meets: bool  # whether the error is known to be within the tolerance
    error: float  # the largest relative error against transport in the query; inf if not known
    numerical_error: float  # the evaluator's share of `error`; a table is built to this error
    cost_ns: float  # time for one value, as measured once on one machine
    prepare_ns: float  # time to prepare one medium, as measured once on one machine


class Offers(NamedTuple):
    """The models and evaluators that could answer a query, cheapest first."""

    offers: tuple[Offer, ...]
    taken: Offer | None  # the offer that eval() would take; None if no offer meets the tolerance


@dataclass(frozen=True)
class Result:
    """The answer to one evaluation, or a part of it.

    Arrays have the precision of the evaluator, float64 or float32, unless their comment says
    another one. The array of a quantity that was not wanted is None. The arrays are read-only and
    may be views of one buffer.
    """

    model: str
    evaluator: str
    moments: str
    r: np.ndarray | None  # [N] mm: the radii of the query. For a grid: None unless r was wanted.
    R: np.ndarray | None  # [C, N] 1/mm^2 per unit of power that entered
    cdf: np.ndarray | None  # [C, N] power that leaves within r over all that leaves, 0 to 1
    dR_dr: np.ndarray | None  # [C, N] 1/mm^3
    ln_R: np.ndarray | None  # [C, N] finite even where R underflows; its error is absolute
    pdf: np.ndarray | None  # [C, N] 1/mm: density of radii, 2 pi r R over the albedo
    two_pi_r_R: np.ndarray | None  # [C, N] 1/mm: finite even where R is infinite at r = 0
    S: np.ndarray | None  # [C, N] 1/(mm^2 sr): the BSSRDF for the parameters cos_in and cos_out
    albedo: np.ndarray | None  # [C] float64: integral of 2 pi r R(r)
    numerical_error_constant: np.ndarray  # [C] numerical_error() adds this constant
    numerical_error_per_mm: np.ndarray  # [C] 1/mm: and this number times the radius
    # [C] error of the model against transport, relative; NaN if it was not measured for these radii
    model_error: np.ndarray
    notes: tuple[str, ...]  # names of the notes, of info.choices["note"], that hold for any channel
    values: dict[str, np.ndarray]  # [C, N] each, by the daemon's names, such as "2_pi_r_R"
    radius_first: int  # position in the query of the first radius of this part; 0 for the whole

    def numerical_error(self, r: np.ndarray | float | None = None) -> np.ndarray:
        """Returns how far a value at radius r may be from the model's exact formula: [C, N],
        relative. r: [N] mm; the default is the result's own radii."""
        radii = np.asarray(self.r if r is None else r, dtype=np.float64)
        # At r = infinity, an error that does not grow with r gives 0 * inf, which is NaN: it is 0.
        with np.errstate(invalid="ignore"):
            growth = np.multiply.outer(self.numerical_error_per_mm, radii)
        growth[np.isnan(growth)] = 0
        return self.numerical_error_constant.reshape((-1,) + (1,) * radii.ndim) + growth


class Draw(NamedTuple):
    """`count` numbers u between 0 and 1 by a rule. Number i, for i from 0 to count - 1, is

    "random": random number first + i of the sequence that belongs to the seed,
    "stratified": (i + random number i of this sequence) / count,
    "regular": (i + 1/2) / count.

    The same seed gives the same bits on every machine.
    """

    count: int
    rule: str = "random"
    seed: int = 1
    first: int = 0


@dataclass(frozen=True)
class Samples:
    """N radii drawn for each of C channels, and the quantities evaluated at these radii. The arrays
    are as in Result."""

    model: str
    evaluator: str
    moments: str
    u: np.ndarray  # [N] the numbers, between 0 and 1, that give the radii of every channel
    r: np.ndarray | None  # [C, N] mm
    pdf: np.ndarray | None  # [C, N] 1/mm: density of radii; pdf / (2 pi r) is that of points
    albedo: np.ndarray | None  # [C] float64: integral of 2 pi r R(r)
    numerical_error_constant: np.ndarray  # [C] see Result.numerical_error()
    numerical_error_per_mm: np.ndarray  # [C] 1/mm: see Result.numerical_error()
    model_error: np.ndarray  # [C] error of the model against transport, relative; NaN: not measured
    notes: tuple[str, ...]  # names of the notes, of info.choices["note"], that hold for any channel
    values: dict[str, np.ndarray]  # [C, N] each quantity that was wanted, by name: "r", "pdf", "R"


@dataclass(frozen=True)
class Inversion:
    """Media with given albedos. The arrays have the shape of the arguments of invert(), and NaN
    where no medium has the albedo under the model."""

    model: str
    moments: str
    sigma_a: np.ndarray  # 1/mm
    sigma_s: np.ndarray  # 1/mm
    g: float
    eta: float
    albedo: np.ndarray  # the albedo of these media under the model
    albedo_least: float  # the least albedo that media of this g and eta have under the model
    albedo_most: float  # the largest one
    missing: int  # number of media that are NaN

    @property
    def media(self) -> np.ndarray:
        """The media as an array [..., 4] of sigma_a, sigma_s, g, eta. eval() takes a [C, 4]."""
        g = np.full_like(self.sigma_a, self.g)
        eta = np.full_like(self.sigma_a, self.eta)
        return np.stack([self.sigma_a, self.sigma_s, g, eta], axis=-1)


class McProgress(NamedTuple):
    """A report on the progress of a Monte Carlo job."""

    number: int  # number of this report: 1, 2, 3 and so on
    photons: int  # number of photons walked so far
    photons_expected: int  # estimate of how many photons the job walks in all
    error_total: float  # relative standard error of the total R, the largest of all albedos
    error_rings: float  # relative standard error of the worst ring with light; inf if not known yet
    worst_ring_mm: tuple[float, float]  # the edges of that ring; (0, 0) if there is none


class McValue(NamedTuple):
    """A fraction of the power that entered, and its standard error."""

    value: float
    error: float


class McEnergy(NamedTuple):
    """The energy balance for one albedo, in fractions of the power that entered. The first value of
    a pair is for the side where light enters, the second one for the other side of a slab."""

    albedo: float
    R: McValue  # leaves on the side where light enters: unscattered + under + all rings + over
    T: McValue  # leaves on the other side of a slab: the same sum
    absorbed: McValue
    unfinished: McValue  # was still inside when the walk of its photon was cut off
    roulette: McValue  # added by Russian roulette minus what roulette removed
    unscattered: tuple[float, float]  # leaves at r = 0 and counts in no ring; exact
    under: tuple[McValue, McValue]  # leaves within the inner edge of the first ring
    over: tuple[McValue, McValue]  # leaves beyond the outer edge of the last ring
    imbalance: float  # R + T + absorbed + unfinished - roulette - 1, which is 0 up to rounding


@dataclass(frozen=True)
class McResult:
    """The result of a Monte Carlo job for K albedos, N rings and S sides. A half space has 1 side,
    a slab has 2. A value is the mean over a ring, in 1/mm^2 per unit of power that entered."""

    state: str  # why the job ended: "photons", "errors", "cancelled" or "stopped"
    photons: int  # number of photons walked
    error_total: float  # as in McProgress
    error_rings: float  # as in McProgress
    worst_ring_mm: tuple[float, float]  # as in McProgress
    edges: np.ndarray  # [N + 1] mm
    energies: tuple[McEnergy, ...]  # [K]
    ring_photons: np.ndarray  # [S, N] number of photons that left in each ring
    values: np.ndarray  # [K, S, N]
    errors: np.ndarray  # [K, S, N] standard errors
    payload: bytes  # of the reply. Equal requests give equal bytes unless a job is ended early.

    @property
    def R(self) -> np.ndarray:
        """The profile on the side where light enters: `values` of side 0, [K, N] 1/mm^2."""
        return self.values[:, 0]

    @property
    def R_error(self) -> np.ndarray:
        """The standard errors of the property R, [K, N] 1/mm^2."""
        return self.errors[:, 0]
