"""What goes into an evaluation and what comes out of it. Lengths in mm, coefficients in 1/mm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


class Medium(NamedTuple):
    """A homogeneous, semi-infinite medium."""

    sigma_a: float  # 1/mm: absorption coefficient, 0 to 1e15
    sigma_s: float  # 1/mm: scattering coefficient, 0 to 1e15
    g: float = 0.0  # mean cosine of the phase function, in (-1, 1)
    eta: float = 1.3  # index inside over index outside, 0.001 to 1000


class Grid(NamedTuple):
    """Radii by rule, both ends included: count of them in equal steps (linear) or ratios."""

    start_mm: float
    stop_mm: float
    count: int
    spacing: str = "linear"  # or "logarithmic"


class Choice(NamedTuple):
    """One entry of a list of the daemon: a model, an evaluator, a status, ..."""

    id: int
    name: str
    about: str  # source of a model, unit of a quantity, meaning of anything else (of a parameter:
    # unit, meaning and range)


@dataclass(frozen=True)
class Info:
    """What a daemon says of itself."""

    address: str
    software: str
    instruction_set: str
    R_unit: str
    protocol_version: int
    workers: int
    choices: dict[str, dict[str, Choice]]  # by kind ("model", ...), then by name
    limits: dict[str, int]  # by name, whose end is the unit: max_frame_bytes


class Offer(NamedTuple):
    """A model and evaluator that could answer a query, how exact and how fast."""

    model: str
    evaluator: str
    meets: bool  # the tolerance; False: not, or not known to
    error: float  # relative, against transport, of all that was asked about; inf: not known
    numerical_error: float  # the share of that which is the evaluator's; of a table: asked of it
    cost_ns: float  # of a value, as measured once, on one machine
    prepare_ns: float  # of a medium, likewise


class Offers(NamedTuple):
    """What could answer a query, cheapest first."""

    offers: tuple[Offer, ...]
    taken: Offer | None  # the one that eval() would take; None: none keeps the tolerance


@dataclass(frozen=True)
class Result:
    """The answer to one evaluation, or a part of it, for C channels (media) and N radii.

    Arrays have the precision of the evaluator, float64 or float32; those that were not wanted
    are None. The arrays are read-only and may be views of one buffer. values holds those that
    have a value for each radius and channel by the daemon's names of the quantities, such as
    "2_pi_r_R".
    """

    model: str
    evaluator: str
    moments: str
    r: np.ndarray | None  # [N] mm: the radii asked for; of a grid only when "r" was wanted
    R: np.ndarray | None  # [C, N] 1/mm^2 per unit of power that entered
    cdf: np.ndarray | None  # [C, N] energy within r over the albedo, 0 to 1
    dR_dr: np.ndarray | None  # [C, N] 1/mm^3
    ln_R: np.ndarray | None  # [C, N] goes on where R has underflowed; its error is absolute
    pdf: np.ndarray | None  # [C, N] 1/mm: density of radii, 2 pi r R over the albedo
    two_pi_r_R: np.ndarray | None  # [C, N] 1/mm, finite at r = 0 where R of some models is inf
    S: np.ndarray | None  # [C, N] 1/(mm^2 sr): the BSSRDF for the parameters cos_in and cos_out
    albedo: np.ndarray | None  # [C] float64, integral of 2 pi r R(r)
    numerical_error_constant: np.ndarray  # [C] see numerical_error()
    numerical_error_per_mm: np.ndarray  # [C] 1/mm
    model_error: np.ndarray  # [C] relative, of the model against transport; NaN: not measured;
    # of a model that a tolerance has chosen: for the radii asked for
    notes: tuple[str, ...]  # names of remarks that hold for a channel or more, see Info.choices
    values: dict[str, np.ndarray]  # [C, N] each, by name
    radius_first: int  # of a part: which of the radii asked for is its first; else 0

    def numerical_error(self, r: np.ndarray | float | None = None) -> np.ndarray:
        """How far a value at radius r (mm, [N]; the result's own by default) may be from the
        model's exact formula: [C, N], relative."""
        radii = np.asarray(self.r if r is None else r, dtype=np.float64)
        # inf * 0 is no number, but an error that does not grow with r does not at infinity either.
        with np.errstate(invalid="ignore"):
            growth = np.multiply.outer(self.numerical_error_per_mm, radii)
        growth[np.isnan(growth)] = 0
        return self.numerical_error_constant.reshape((-1,) + (1,) * radii.ndim) + growth
