"""What users give to a client and what they get from it.

Lengths are in mm and coefficients in 1/mm. In the shapes, C is the number of channels (media) and
N the number of radii.
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
    """`count` radii from start_mm to stop_mm, both included, in equal steps or equal ratios."""

    start_mm: float
    stop_mm: float
    count: int
    spacing: str = "linear"  # or "logarithmic"


@dataclass(frozen=True, eq=False)
class Query:
    """What is to be evaluated. A client's calls take either a Query or the same arguments:
    client.eval("better", skin, [0.5, 1.0]) is client.eval(Query("better", skin, [0.5, 1.0])).

    model: a name or an id. None takes the cheapest model and evaluator that are measured to be
        within `tolerance` of radiative transport, for all media and from the smallest to the
        largest radius. The result says which ones were taken. The daemon refuses the query when no
        model is known to be good enough.
    media: one Medium, several of them, or an array [C, 4] of sigma_a, sigma_s, g and eta.
    r: N radii in mm, from 0 to infinity.
    grid: the radii by a rule, in place of r. A grid costs no bytes in the request.
    evaluator: "f64" computes in double precision. "f32" computes and "lut" looks up in a table,
        both in single precision. The default is "f64" for a model. For model None it only chooses
        the precision, and the default is single precision.
    moments: "exact", or "fit" for the polynomials.
    wanted: names of quantities. The default is R, albedo, cdf and, with a grid, r.
    parameters: optional numbers by name, for example {"cos_in": 0.8}. Their units and ranges are in
        info.choices["parameter"]. The value of fit_model may also be the name of a model. A model
        refuses a parameter that it does not take.
    tolerance: the parameter of that name. With a model it is the numerical error that is allowed,
        relative; with the evaluator "lut" it is what the table is built to.
    deadline_ms: how long the answer may take from the arrival of the query; 0 is no limit.
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
        """The query that is the only argument, or the one that the arguments describe."""
        first = arguments[0] if arguments else options.get("model")
        if isinstance(first, Query) and len(arguments) + len(options) == 1:
            return first
        return cls(*arguments, **options)


class Choice(NamedTuple):
    """One entry of a list of the daemon: a model, an evaluator, a status and so on."""

    id: int
    name: str
    about: str  # source of a model, unit of a quantity, or meaning


@dataclass(frozen=True)
class Info:
    """What a daemon says about itself."""

    address: str
    software: str
    instruction_set: str
    R_unit: str
    protocol_version: int
    workers: int
    choices: dict[str, dict[str, Choice]]  # by kind, such as "model", then by name
    limits: dict[str, int]  # by name. The end of the name is the unit: max_frame_bytes.


class Offer(NamedTuple):
    """A model and evaluator that could answer a query, how exact they are and how fast."""

    model: str
    evaluator: str
    meets: bool  # whether it is known to keep the tolerance
    error: float  # relative, against transport, for all that was asked about; inf if not known
    numerical_error: float  # the evaluator's part of it. Of a table: the error it is built to.
    cost_ns: float  # of one value, as measured once on one machine
    prepare_ns: float  # of one medium, measured likewise


class Offers(NamedTuple):
    """What could answer a query, cheapest first."""

    offers: tuple[Offer, ...]
    taken: Offer | None  # the one that eval() would take; None if none keeps the tolerance


@dataclass(frozen=True)
class Result:
    """The answer to one evaluation, or a part of it.

    Arrays have the precision of the evaluator, float64 or float32. An array that was not wanted is
    None. The arrays are read-only and may be views of one buffer.
    """

    model: str
    evaluator: str
    moments: str
    r: np.ndarray | None  # [N] mm: the radii asked for. With a grid, only if "r" was wanted.
    R: np.ndarray | None  # [C, N] 1/mm^2 per unit of power that entered
    cdf: np.ndarray | None  # [C, N] energy within r over the albedo, 0 to 1
    dR_dr: np.ndarray | None  # [C, N] 1/mm^3
    ln_R: np.ndarray | None  # [C, N] also where R has underflowed. Its error is absolute.
    pdf: np.ndarray | None  # [C, N] 1/mm: density of radii, 2 pi r R over the albedo
    two_pi_r_R: np.ndarray | None  # [C, N] 1/mm: finite at r = 0, where some models' R is inf
    S: np.ndarray | None  # [C, N] 1/(mm^2 sr): the BSSRDF for the parameters cos_in and cos_out
    albedo: np.ndarray | None  # [C] float64: integral of 2 pi r R(r)
    numerical_error_constant: np.ndarray  # [C] see numerical_error()
    numerical_error_per_mm: np.ndarray  # [C] 1/mm
    # [C] relative, of the model against transport; NaN if it was not measured. Of a model that a
    # tolerance has chosen, it holds for the radii asked for.
    model_error: np.ndarray
    notes: tuple[str, ...]  # names of remarks that hold for at least one channel: info.choices
    values: dict[str, np.ndarray]  # [C, N] each, by the daemon's names, such as "2_pi_r_R"
    radius_first: int  # position of a part's first radius among those asked for; else 0

    def numerical_error(self, r: np.ndarray | float | None = None) -> np.ndarray:
        """How far a value at radius r may be from the model's exact formula: [C, N], relative.
        r: mm, [N]; the default is the result's own radii."""
        radii = np.asarray(self.r if r is None else r, dtype=np.float64)
        # inf * 0 is NaN, but an error that does not grow with r does not grow at infinity either.
        with np.errstate(invalid="ignore"):
            growth = np.multiply.outer(self.numerical_error_per_mm, radii)
        growth[np.isnan(growth)] = 0
        return self.numerical_error_constant.reshape((-1,) + (1,) * radii.ndim) + growth


class Draw(NamedTuple):
    """Numbers u by a rule, between 0 and 1. For i from 0 to count - 1:

    "random" takes random number first + i of the seed, "stratified" (i + number i of the seed) /
    count, and "regular" (i + 1/2) / count. The same seed gives the same bits everywhere.
    """

    count: int
    rule: str = "random"
    seed: int = 1
    first: int = 0


@dataclass(frozen=True)
class Samples:
    """Radii drawn for C channels with N numbers, and what was evaluated at these radii.

    Arrays are as in Result.
    """

    model: str
    evaluator: str
    moments: str
    u: np.ndarray  # [N] the numbers, which are the same for every channel
    r: np.ndarray | None  # [C, N] mm
    pdf: np.ndarray | None  # [C, N] 1/mm: density of radii. The density of points: pdf / (2 pi r).
    albedo: np.ndarray | None  # [C] float64: integral of 2 pi r R(r)
    numerical_error_constant: np.ndarray  # [C] A value at radius r is off by at most this
    numerical_error_per_mm: np.ndarray  # [C] 1/mm   plus this times r, relative.
    model_error: np.ndarray  # [C] relative, of the model against transport; NaN if not measured
    notes: tuple[str, ...]  # names of remarks that hold for at least one channel: info.choices
    values: dict[str, np.ndarray]  # [C, N] all that was wanted, by name: "r", "pdf", "R" and so on


@dataclass(frozen=True)
class Inversion:
    """Media with given albedos. Arrays have the shape of what was given, and NaN where the model
    cannot reach the albedo."""

    model: str
    moments: str
    sigma_a: np.ndarray  # 1/mm
    sigma_s: np.ndarray  # 1/mm. sigma_s (1 - g) is sigma_s'.
    g: float
    eta: float
    albedo: np.ndarray  # which these media have under the model
    albedo_least: float  # the range that the model can reach with this g and eta
    albedo_most: float
    missing: int  # how many media are NaN

    @property
    def media(self) -> np.ndarray:
        """[..., 4]: sigma_a, sigma_s, g, eta. eval() takes it when it is [C, 4]."""
        g = np.full_like(self.sigma_a, self.g)
        eta = np.full_like(self.sigma_a, self.eta)
        return np.stack([self.sigma_a, self.sigma_s, g, eta], axis=-1)


class McProgress(NamedTuple):
    """How far a Monte Carlo job has come."""

    number: int  # of this report: 1, 2, 3 and so on
    photons: int  # walked so far
    photons_expected: int  # how many it will take in all, as far as is known
    error_total: float  # relative standard error of R, the largest of all albedos
    error_rings: float  # relative standard error of the worst ring with light; inf if not known yet
    worst_ring_mm: tuple[float, float]  # the edges of that ring; (0, 0) if there is none


class McValue(NamedTuple):
    """A fraction of the power that entered, and its standard error."""

    value: float
    error: float


class McEnergy(NamedTuple):
    """Where the power went for one albedo, as fractions of what entered. Pairs are by side: where
    light enters, then the other side of a slab."""

    albedo: float
    R: McValue  # leaves where light enters: unscattered, under, rings and over together
    T: McValue  # leaves on the other side of a slab, likewise
    absorbed: McValue
    unfinished: McValue  # was still inside when its walk was given up
    roulette: McValue  # what roulette has added minus what it has removed
    unscattered: tuple[float, float]  # leaves at r = 0, in no ring; exact
    under: tuple[McValue, McValue]  # leaves within the inner edge of the first ring
    over: tuple[McValue, McValue]  # leaves beyond the outer edge of the last ring
    imbalance: float  # R + T + absorbed + unfinished - roulette - 1, which is 0 up to rounding


@dataclass(frozen=True)
class McResult:
    """The table of a Monte Carlo job for K albedos, N rings and S sides. A half space has 1 side, a
    slab has 2. Values are means over their ring, in 1/mm^2 per unit of power that entered."""

    state: str  # why the job ended: "photons", "errors", "cancelled" or "stopped"
    photons: int  # walked
    error_total: float  # as in McProgress
    error_rings: float
    worst_ring_mm: tuple[float, float]
    edges: np.ndarray  # [N + 1] mm
    energies: tuple[McEnergy, ...]  # [K]
    ring_photons: np.ndarray  # [S, N] how many left in each ring, whatever their weight
    values: np.ndarray  # [K, S, N]
    errors: np.ndarray  # [K, S, N] standard errors
    payload: bytes  # as received. The same request gives the same bytes unless it is ended early.

    @property
    def R(self) -> np.ndarray:
        """What leaves where light enters, [K, N] 1/mm^2."""
        return self.values[:, 0]

    @property
    def R_error(self) -> np.ndarray:
        """Standard errors of R, [K, N] 1/mm^2."""
        return self.errors[:, 0]
