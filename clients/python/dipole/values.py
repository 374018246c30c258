"""The types of a client's arguments and results.

Lengths are in mm and coefficients in 1/mm. In the shapes of arrays, C is the number of channels
(media) and N the number of radii.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any, NamedTuple, TypedDict, TypeVar, Union

import numpy as np
from numpy.typing import NDArray

from . import wire
from .errors import naming

Array = NDArray[Any]
T = TypeVar("T")

def span(array: Any) -> str:
    """Describes numbers by the least and the largest of them."""
    numbers = np.asarray(array, np.float64)
    numbers = numbers[~np.isnan(numbers)]
    if numbers.size == 0:
        return "nan" if np.size(array) else "none"
    low, high = f"{numbers.min():.3g}", f"{numbers.max():.3g}"
    return low if low == high else f"{low} to {high}"


def _text(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_text(one)}" for name, one in value.items())
    if isinstance(value, np.ndarray) and value.ndim:
        return f"{list(value.shape)} {'' if value.dtype.names else span(value)}".strip()
    return f"{value:.4g}" if isinstance(value, (float, np.ndarray)) else str(value)


def shows(*names: str) -> Callable[[type[T]], type[T]]:
    """Makes the repr of a class: these attributes of an object, in at most three lines that fit a
    terminal. Arrays are shown by their shape and range."""

    def describe(one: Any) -> str:
        listed = "; ".join(f"{name} {_text(getattr(one, name))}" for name in names)
        text = f"<{type(one).__name__}: {listed}>"
        return textwrap.fill(text, 100, subsequent_indent="  ", max_lines=3, placeholder=" ...")

    def add(to: type[T]) -> type[T]:
        setattr(to, "__repr__", describe)  # noqa: B010  (mypy rejects the attribute)
        return to

    return add


def whole(number: Any) -> Any:
    """Returns 200000 for 2e5, and everything that is no whole number unchanged."""
    is_whole = isinstance(number, (float, np.floating)) and number.is_integer()
    return int(number) if is_whole else number


class Medium(NamedTuple):
    """A half space, a slab or a layer of a Stack. Its fields are numbers; for Client.values(), they may be arrays
    that broadcast against each other."""

    sigma_a: Any  # 1/mm: absorption coefficient, 0 to 1e15
    sigma_s: Any  # 1/mm: scattering coefficient, 0 to 1e15
    g: Any = 0.0  # mean cosine of the phase function, between -1 and 1
    eta: Any = 1.3  # index of refraction inside over that outside, 0.001 to 1000
    thickness: Any = 0.0  # mm: 0 is a half space


class Stack(tuple[Medium, ...]):
    """A medium of up to 8 layers: Stack(epidermis, dermis), from the top down. Each but the last has a
    thickness. It may stand wherever one Medium may, in a list of media, too."""

    def __new__(cls, *layers: Medium) -> Stack:
        return super().__new__(cls, layers)  # type: ignore[arg-type]  # mypy, of any tuple

    def __repr__(self) -> str:
        return f"Stack{super().__repr__()}"


Media = Union[Medium, Stack, str, Iterable[Union[Sequence[float], Stack]], Array]
# media by name, each with the channels red, green and blue
MeasuredMedia = dict[str, tuple[Union[Medium, Stack], ...]]


def refuse_unknown(options: Iterable[str], known: Iterable[str]) -> None:
    """Refuses options that a call does not have."""
    for name in options:
        if name not in known:
            raise TypeError(
                f"{name}: no option of this call; a number that a model takes belongs in "
                f'parameters={{"{name}": ...}}'
            )


class Grid(NamedTuple):
    """`count` radii from start_mm to stop_mm, both included. Neighbours have the same difference
    (spacing "linear") or the same ratio ("logarithmic")."""

    start_mm: float
    stop_mm: float
    count: int  # type: ignore[assignment]  # hides tuple.count()
    spacing: str = "linear"


@dataclass(frozen=True, eq=False)
class Query:
    """A description of what to evaluate. A client's calls take either a Query or its arguments:
    client.eval("better", skin, [0.5, 1.0]) is client.eval(Query("better", skin, [0.5, 1.0])).

    model: a name or an id. With None, the daemon takes transport in the cheapest evaluator that is
        within `tolerance` of radiative transport, for all media and from the smallest to the
        largest radius. The time to prepare a medium counts, so that few radii may get another
        evaluator than many. The result names both. The daemon refuses the query if no evaluator
        is accurate enough.
    media: one Medium; one Stack of layers; a list of several; an array [C, 4] of sigma_a, sigma_s, g
        and eta, or [C, 5] with thickness, or [C, L, 5] of stacks of L layers; or the name of a medium
        of media(), which stands for its red, green and blue channel.
    r: N radii in mm, from 0 to infinity. Only wanted=["albedo", "balance"] needs no radii.
    grid: the radii by a rule, in place of r. The request then lists no radii.
    evaluator: "f64" computes in double precision and "f32" in single precision. "lut" looks values
        up in a table in single precision. If a model is named, the default is "f64". "lut" takes
        milliseconds for each medium and then the least for a radius. If the model is None, the
        evaluator only says the precision, and the default is single precision.
        A fit needs "f64": the step by which a least-squares routine usually changes a coefficient
        (1.5e-8 of it) does not change a value in single precision, so that the routine sees no
        slope, stops at its first guess and reports success. examples/fit.py shows a fit.
    moments: how Fresnel reflection is integrated: "exact", or "fit" by published polynomials.
    wanted: names of quantities, or one name. The default is R, albedo, cdf and, with a grid, r. If
        the model is None, the cdf is not among them, because it keeps fewer tolerances than R.
    parameters: optional numbers by name, for example {"cos_in": 0.8}. Their units and ranges are in
        info.choices["parameter"]. The values of fit_model and phase may also be names. The
        daemon refuses a parameter that the model does not have.
    tolerance: the parameter "tolerance", a relative error. If the model is None, it limits the
        deviation from transport. If a model is named, it limits the numerical error; for "lut",
        the daemon builds the table to this error.
    deadline_ms: how long the reply may take from the arrival of the query; 0 means no limit.
    model_error: whether to compare the model with transport at these radii, which takes a
        millisecond for each new medium.
    """

    model: str | int | None
    media: Media
    r: Any = None
    _: KW_ONLY
    grid: Grid | None = None
    evaluator: str | int | None = None
    moments: str | int = "exact"
    wanted: str | Iterable[str] | None = None
    parameters: Mapping[str, float | str] | None = None
    tolerance: float | None = None
    deadline_ms: int = 0
    model_error: bool = True

    @classmethod
    def of(cls, *arguments: Any, **options: Any) -> Query:
        """Returns the only argument if that is a Query, else the Query with these arguments."""
        first = arguments[0] if arguments else options.get("model")
        if isinstance(first, Query) and len(arguments) + len(options) == 1:
            return first
        refuse_unknown(options, cls.__dataclass_fields__)
        return cls(*arguments, **options)


# Fields of a Query that calls take as options.


class Options(TypedDict, total=False):
    """Of a call that prepares a model."""

    moments: str | int
    parameters: Mapping[str, float | str] | None
    tolerance: float | None
    deadline_ms: int


class EvaluatorOptions(Options, total=False):
    """Of a call that evaluates a model, too."""

    evaluator: str | int | None


class SampleOptions(EvaluatorOptions, total=False):
    """Of a call whose quantities may be chosen, too."""

    wanted: str | Iterable[str] | None


class OffersOptions(SampleOptions, total=False):
    """All but the model, the media and r."""

    grid: Grid | None


class Choice(NamedTuple):
    """One entry of the daemon's lists: a model, an evaluator, a status and so on."""

    id: int
    name: str
    about: str  # source of a model, unit of a quantity, or meaning


@shows("software", "address", "instruction_set", "protocol_version", "workers")
@dataclass(frozen=True, repr=False)
class Info:
    """A daemon's description of itself: its reply to hello."""

    address: str  # address of the first daemon; Client.address is the one in use
    software: str
    instruction_set: str
    R_unit: str
    protocol_version: int
    workers: int
    choices: dict[str, dict[str, Choice]]  # by kind and name, as choices["model"]["better"]
    limits: dict[str, int]  # limits by name; a name ends in its unit, as max_frame_bytes


class Errors(NamedTuple):
    """How far the values of a quantity may be off, for C channels."""

    # A value at radius r is within numerical_error + numerical_error_per_mm r of the model's formula,
    # relative, for ln R, its derivatives, paths and modulated light absolute.
    numerical_error: Array  # [C]
    numerical_error_per_mm: Array  # [C] 1/mm
    # [C] error of the model against transport at the query's radii; NaN: not known
    model_error: Array


class Offer(NamedTuple):
    """A model and an evaluator that could evaluate a query, with their error and their cost."""

    model: str
    evaluator: str
    meets: bool  # whether the error is known to be within the tolerance
    error: float  # the largest relative error against transport in the query; inf if not known
    numerical_error: float  # the evaluator's share of `error`; a table is built to this error
    cost_ns: float  # time for one value, as measured once on one machine
    prepare_ns: float  # time to prepare one medium, as measured once on one machine


@shows("taken", "offers")
class Offers(NamedTuple):
    """The models and evaluators that could evaluate a query, cheapest first: by prepare_ns + cost_ns
    for each radius and wanted quantity."""

    offers: tuple[Offer, ...]
    taken: Offer | None  # the offer that eval() would take; None if no offer meets the tolerance


class _Quantity(property):
    """A property: the quantity with this name of a result, and its documentation."""

    def __init__(self, name: str, about: str):
        super().__init__(lambda result: result._quantity(name))
        self.__doc__ = about

    def __get__(self, result: Any, owner: type | None = None) -> Array:
        found: Array = super().__get__(result, owner)
        return found


class _Root(_Quantity):
    """A property: the root of a quantity."""

    def __get__(self, result: Any, owner: type | None = None) -> Array:
        found = super().__get__(result, owner)
        return found if result is None else np.asarray(np.sqrt(found))


@shows("model", "evaluator", "quantities", "model_error", "notes")
@dataclass(frozen=True, eq=False)
class _Evaluated:
    """The fields that Result and Samples share.

    Arrays have the precision of the evaluator, float64 or float32, unless their comment says
    another one. Reading a quantity that was not wanted raises AttributeError. The arrays are
    read-only and may be views of one buffer.
    """

    model: str
    evaluator: str
    moments: str
    errors: dict[str, Errors]  # errors of each wanted quantity, by its name
    notes: tuple[str, ...]  # names of the notes, of info.choices["note"], that hold for any channel
    quantities: dict[str, Array]  # every quantity of the result by the daemon's name

    @property
    def values(self) -> dict[str, Array]:
        """Quantities with a value for each channel and radius, [C, N], by the daemon's names."""
        return {name: array for name, array in self.quantities.items() if array.ndim == 2}

    @property
    def model_error(self) -> Array:
        """[C]: the largest error of the model against transport at these radii, of all quantities;
        NaN if that of one is not known, or if they were not wanted. `errors` has each."""
        if "model_error" in self.errors:
            return self.errors["model_error"].model_error
        return np.full(len(next(iter(self.errors.values())).model_error), np.nan)

    # quantities: begin
    R = _Quantity("R", "[C, N] 1/mm^2: per unit of power that entered.")
    albedo = _Quantity("albedo", "[C] 1: integral of 2_pi_r_R.")
    cdf = _Quantity("cdf", "[C, N] 1: share of the albedo within r.")
    dR_dr = _Quantity("dR_dr", "[C, N] 1/mm^3.")
    ln_R = _Quantity("ln_R", "[C, N] ln(1/mm^2): finite where R underflows.")
    pdf = _Quantity("pdf", "[C, N] 1/mm: derivative of the cdf.")
    two_pi_r_R = _Quantity("2_pi_r_R", "[C, N] 1/mm: finite at 0.")
    S = _Quantity("S", "[C, N] 1/(mm^2 sr): BSSRDF at cos_in, cos_out.")
    R_f = _Quantity("R_f", "[C, N] 1: integral of 2_pi_r_R J0(2 pi f r).")
    dlnR_dln_sigma_a = _Quantity("dlnR_dln_sigma_a", "[C, N] 1: for fits.")
    dlnR_dln_sigma_s = _Quantity("dlnR_dln_sigma_s", "[C, N] 1: for fits.")
    model_errors = _Quantity("model_errors", "[C, N] 1: of each radius.")
    T = _Quantity("T", "[C, N] 1/mm^2: as R, below the last layer: transport; 0 below half spaces.")
    path = _Quantity("path", "[C, N] mm: mean length in the medium.")
    dpf = _Quantity("dpf", "[C, N] 1: path/r.")
    time = _Quantity("time", "[C, N] ps: on paths, by the index.")
    phase = _Quantity("phase", "[C, N] degrees: lag of modulated light.")
    modulation = _Quantity("modulation", "[C, N] 1: its amplitude.")
    balance = _Quantity("balance", "[C] 1: where power goes.")
    phase_f = _Quantity("phase_f", "[C, N] degrees: of R_f.")
    modulation_f = _Quantity("modulation_f", "[C, N] 1: of R_f.")
    # quantities: end

    def _quantity(self, name: str) -> Array:
        if name not in self.quantities:
            found = ", ".join(self.quantities) or "none"
            raise AttributeError(f"{name}: was not wanted. The result has: {found}")
        return self.quantities[name]


@dataclass(frozen=True, eq=False, repr=False)
class Result(_Evaluated):
    """The result of one evaluation, or a part of it."""

    radius_first: int  # position in the query of the first radius of this part; 0 for the whole

    r = _Quantity(
        "r",
        "[N] mm, or 1/mm with quantities that end with _f: the radii of the query. A grid has "
        "them only if r was wanted.",
    )

    def numerical_error(self, r: Array | float | None = None, quantity: str | None = None) -> Array:
        """Returns how far a value at radius r may be from the model's exact formula: [C, N],
        relative, for ln R, its derivatives, paths and modulated light absolute. r: [N] mm; the default is the result's own
        radii. quantity: its name, such as "R"; None takes the largest of all wanted ones."""
        with naming(f"quantity: one of {', '.join(self.errors)}"):
            chosen = list(self.errors.values()) if quantity is None else [self.errors[quantity]]
        constants = np.max([one.numerical_error for one in chosen], axis=0)
        per_mm = np.max([one.numerical_error_per_mm for one in chosen], axis=0)
        with naming('r: radii in mm; a quantity is named as quantity="cdf"'):
            radii = np.asarray(self.r if r is None else r, dtype=np.float64)
        # At r = infinity, an error that does not grow with r gives 0 * inf, which is NaN: it is 0.
        with np.errstate(invalid="ignore"):
            growth: Array = np.multiply.outer(per_mm, radii)
        growth[np.isnan(growth)] = 0
        constant: Array = constants.reshape((-1,) + (1,) * radii.ndim)
        return constant + growth


class Draw(NamedTuple):
    """`count` numbers u between 0 and 1 by a rule. Number i, for i from 0 to count - 1, is

    "random": random number first + i of the sequence that belongs to the seed,
    "stratified": (i + random number i of this sequence) / count,
    "regular": (i + 1/2) / count.

    The same seed gives the same bits on every machine.
    """

    count: int  # type: ignore[assignment]  # hides tuple.count()
    rule: str = "random"
    seed: int = 1
    first: int = 0


@dataclass(frozen=True, eq=False, repr=False)
class Samples(_Evaluated):
    """N radii drawn for each of C channels, and the quantities evaluated at these radii."""

    u: Array  # [N] the numbers, between 0 and 1, that give the radii of every channel

    r = _Quantity(
        "r",
        "[C, N] mm. A point at this distance in any direction has the density pdf / (2 pi r).",
    )


@shows("model", "sigma_a", "sigma_s", "albedo", "g", "eta", "missing")
@dataclass(frozen=True, eq=False)
class Inversion:
    """Media with given albedos. The arrays have the shape of the arguments of invert(), and NaN
    where no medium has the albedo under the model."""

    model: str
    moments: str
    sigma_a: Array  # 1/mm
    sigma_s: Array  # 1/mm
    g: float
    eta: float
    albedo: Array  # the albedo of these media under the model
    albedo_least: float  # the least albedo that media of this g and eta have under the model
    albedo_most: float  # the largest one
    missing: int  # number of media that are NaN
    sigma_a_error: Array  # 1/mm: the most by which sigma_a is off the model's exact formula
    sigma_s_error: Array  # 1/mm
    model_error: Array  # how far the albedo is from transport's, relative; NaN: unknown

    @property
    def media(self) -> Array:
        """The media as an array [..., 4] of sigma_a, sigma_s, g, eta. eval() takes a [C, 4]."""
        g = np.full_like(self.sigma_a, self.g)
        eta = np.full_like(self.sigma_a, self.eta)
        return np.stack([self.sigma_a, self.sigma_s, g, eta], axis=-1)


class Estimate(NamedTuple):
    """What was found of one unknown of a fit of layers."""

    status: str  # "fitted", "at-bound" or "undetermined"
    value: float  # in 1/mm or mm; NaN if undetermined
    error: float  # its standard error; infinity unless fitted


class LayersFit(NamedTuple):
    """What was fitted to readings of layers."""

    status: str  # only "fitted" is a success; "ambiguous": other values fit as well
    estimates: dict[str, Estimate]  # by the names of the unknowns
    factor: float  # of all readings; 1 unless the scale is "free"
    factor_error: float  # its standard error
    chi_squared: float
    reduced_chi_squared: float  # over readings less unknowns; NaN if there are as many unknowns
    numerical_error: float  # largest of R at the readings, relative; in no standard error
    residuals: Array  # [N]: (value - factor R) / error


@dataclass(frozen=True, eq=False)
class TissueFits:
    """What was fitted to sets of readings of a tissue, in arrays of the shape of the sets. With status
    "refused" all numbers are NaN."""

    sets: Array  # a structured array with the fields of `fitted_tissue` in PROTOCOL.md
    # by the names of what was sought: structured arrays with status, value, error and numerical
    estimates: dict[str, Array]
    covariance: Array  # [..., n, n] of the estimates, in their order and units
    residuals: Array | None  # [..., W, P]: (value - factor R) / error; None if not wanted
    status_names: dict[int, str]  # the name of each number of a status
    haemoglobin: str  # the table of its absorption
    g: float  # of all media
    eta: float

    def status(self, name: str | None = None) -> Array:
        """The names of how each set, or one of its estimates, has ended; only "fitted" is a success."""
        found = self.sets if name is None else self.estimates[name]
        names: Array = np.vectorize(self.status_names.get, otypes=[object])(found["status"])
        return names


@shows(
    "counts", "g", "g_is_default", "eta", "sigma_a", "sigma_s_prime", "reduced_chi_squared",
    "model_error",
)
@dataclass(frozen=True, eq=False)
class Fits:
    """What was fitted to sets of readings. Arrays have the shape of the sets: that of the values of
    fit() without its last axis. With status "refused" all numbers are NaN: the reading number
    sets["index"] is not finite (sets["field"] is 1), or its error is not above 0 (2)."""

    sets: Array  # a structured array with the fields of `fitted` in PROTOCOL.md
    residuals: Array | None  # [..., N]: (value - factor model) / error; None if not wanted
    status_names: dict[int, str]  # the name of each number of `sets["status"]`
    g: float  # of all media
    eta: float
    g_is_default: bool  # whether g was not given

    @property
    def counts(self) -> dict[str, int]:
        """How many sets have ended in each way, by the names of status."""
        numbers = zip(*np.unique(self.sets["status"], return_counts=True))
        return {self.status_names[number]: int(count) for number, count in numbers}

    def _quantity(self, name: str) -> Array:
        field: Array = self.sets[name]
        return field

    @property
    def status(self) -> Array:
        """The names of how each fit has ended; only "fitted" is a success."""
        names: Array = np.vectorize(self.status_names.get, otypes=[object])(self.sets["status"])
        return names

    @property
    def fitted(self) -> Array:
        """Whether each fit is a success."""
        fitted: Array = self.sets["status"] == wire.FIT_FITTED
        return fitted

    sigma_a = _Quantity("sigma_a", "1/mm.")
    sigma_s_prime = _Quantity("sigma_s_prime", "sigma_s (1 - g), 1/mm.")
    sigma_a_error = _Root("variance_a", "The standard error of sigma_a, 1/mm.")
    sigma_s_prime_error = _Root("variance_s", "The standard error of sigma_s', 1/mm.")

    @property
    def correlation(self) -> Array:
        """The correlation of the errors of sigma_a and sigma_s', from -1 to 1."""
        with np.errstate(invalid="ignore"):
            product = self.sigma_a_error * self.sigma_s_prime_error
            correlation: Array = self.sets["covariance_a_s"] / product
        return correlation

    model_error = _Quantity(
        "model_error",
        "The relative error of R against radiative transport, at the distances of the readings and "
        "between them: of the model, and with detector_na of the share that is detected. It is not "
        "part of the standard errors. NaN: not known, as for every other model than transport.",
    )

    factor = _Quantity("factor", 'The factor of all readings; 1 unless the scale is "free".')
    factor_error = _Root(
        "variance_factor",
        'The standard error of the factor; 0 unless the scale is "free".',
    )
    chi_squared = _Quantity("chi_squared", "The sum of the squares of the residuals.")
    reduced_chi_squared = _Quantity(
        "reduced_chi_squared",
        "chi_squared over readings less unknowns; NaN if there are as many unknowns.",
    )
    condition = _Quantity(
        "condition",
        "The largest over the least standard error along any direction of ln sigma_a and ln "
        "sigma_s'.",
    )


@shows("model", "evaluator", "g", "eta", "faults", "quantities", "coefficients")
@dataclass(frozen=True, eq=False)
class Varying:
    """Values each of which has its own medium. The arrays have the shape of the arguments of
    varying(), and NaN where there is no value."""

    model: str
    moments: str
    evaluator: str
    g: float
    eta: float
    quantities: dict[str, Array]  # arrays of the wanted quantities, by name
    coefficients: dict[str, Array]  # arrays of the wanted coefficients: sigma_a, sigma_s, scattered
    statuses: Array  # numbers of uint8, ids of info.choices["value"]
    faults: dict[str, str]  # what is allowed, for each status of a value that is NaN
    notes: tuple[str, ...]
    numerical_error: float  # largest relative error of values whose status is "ok"
    model_error: float  # relative error against transport; nan if that is not solved
    colour_least: float  # the range of colours that media have, if colours were given; else nan
    colour_most: float
    specular: float  # the share of the light that the surface reflects; nan without colours

    def __getitem__(self, name: str) -> Array:
        """The array of a quantity or of a coefficient."""
        return self.quantities[name] if name in self.quantities else self.coefficients[name]

    @property
    def computed(self) -> Array:
        """Whether each value was computed."""
        return self.statuses <= 1


@shows("model", "evaluator", "tolerance", "M", "bound")
@dataclass(frozen=True, eq=False)
class Gathered:
    """Sums of the light of points, for C channels."""

    model: str | int  # name; an id if a table was loaded without a daemon's lists
    moments: str | int
    evaluator: str
    tolerance: float
    M: Array  # [..., C] W/mm^2, in the shape of the queries; nan where the caller ended the call
    bound: float  # relative error that grouping points has caused at most; within the tolerance
    numerical_error: Array  # [C] relative error of the evaluator and of rounding
    model_error: Array  # [C] of R against radiative transport, relative, from 0.01 to 20 mean free
    # paths; nan if transport is not solved
    points_visited: int  # points that were summed one by one
    nodes_visited: int  # groups of points that were summed as one
    notes: tuple[str | int, ...]


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


class _Side(_Quantity):
    """A property: `values` or `errors` of a side."""

    def __init__(self, array: str, side: int, about: str):
        property.__init__(self, lambda result: getattr(result, array)[:, side], doc=about)


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
    in_layer: tuple[McValue, ...]  # absorbed in each layer, from the top down; else 0
    imbalance: float  # R + T + absorbed + unfinished - roulette - 1, which is 0 up to rounding


@shows("state", "photons", "error_total", "error_rings", "edges", "values")
@dataclass(frozen=True, eq=False)
class McResult:
    """The result of a Monte Carlo job for K albedos, N rings and S sides. A half space has 1 side,
    a slab has 2. A value is the mean over a ring, in 1/mm^2 per unit of power that entered."""

    state: str  # why the job ended: "photons", "errors", "cancelled" or "stopped"
    photons: int  # number of photons walked
    error_total: float  # as in McProgress
    error_rings: float  # as in McProgress
    worst_ring_mm: tuple[float, float]  # as in McProgress
    edges: Array  # [N + 1] mm
    energies: tuple[McEnergy, ...]  # [K]
    ring_photons: Array  # [S, N] number of photons that left in each ring
    values: Array  # [K, S, N]
    errors: Array  # [K, S, N] standard errors of the values
    payload: bytes  # payload of the reply; equal for equal requests unless a job ends early

    R = _Side("values", 0, "The profile on the side where light enters, [K, N] 1/mm^2.")
    R_error = _Side("errors", 0, "The standard errors of the property R, [K, N] 1/mm^2.")
    T = _Side(
        "values", 1, "The profile of the light that leaves below a slab or the last layer, [K, N] "
        "1/mm^2. A half space has none: IndexError.",
    )  # fmt: skip
    T_error = _Side("errors", 1, "The standard errors of the property T, [K, N] 1/mm^2.")
