/* Radiative transport itself: the model evaluates solutions of the equation of core/transport/.
 *
 * Preparation takes the solution of a half space from the table of solutions (core/transport/table.h)
 * wherever that covers the medium, and solves it elsewhere (core/solver/solver.h), which takes
 * seconds. It solves stored media, too, if the parameter `tolerance` is below what the table states,
 * unless a table for single precision is made of the profile. The kernels evaluate Legendre series of
 *
 *   L(ln x) = ln(x R(x)) + kappa x
 *
 * in panels of ln x, where x is the radius in mean free paths 1 / sigma_t'. Since 1 / x at the source
 * and e^(-kappa x) far away are divided out, a series of 16 terms is exact to SERIES_ERROR. R stays
 * positive between the points. The energy within r is integrated from the same series
 * (core/energy.h). The albedo is the solution's own total.
 *
 * Derivatives: R(r; sigma_a, sigma_s) = sigma_t'^2 R(x; rho), rho = sigma_a / sigma_s', so that
 *
 *   d ln R / d ln sigma_a = (1 - a) (2 + d ln R / d ln x) + d ln R / d ln rho,
 *   d ln R / d ln sigma_s = a (2 + d ln R / d ln x) - d ln R / d ln rho,
 *
 * with the albedo a = 1 / (1 + rho) of scattering. If they are requested, the derivative of L by ln
 * rho is a second series: a central difference of two more media of the table or of the solver. Of
 * layers there are two more series, d ln R by ln sigma_a and by ln sigma_s of one layer, which are
 * central differences of four more solutions. They are computed on two grids, and the error is a
 * multiple of what these differ by, by bands of radii.
 *
 * Domain: g from -0.98 to 0.99, eta from 0.25 to 4, sigma_a up to 1000 sigma_s', and media that
 * scatter nothing. Below FIRST mean free paths R is continued in proportion to 1 / x. The last radius
 * is the table's reach; of solutions, LAST_SOLVED or where R falls below TRANSPORT_TABLE_R_LEAST. Beyond it R is continued in
 * proportion to the diffusion of a dipole, (1 + kappa x) e^(-kappa x) / x^3, times a factor that keeps
 * the slope at the last radius. That factor is a power of x; if R is still that of white media there, it is
 * instead the next term of that diffusion, in 1 / x^2, which is as accurate as the solution.
 *
 * Error, up to the reach that the profile reports: that of the table, by bands of radii for g other
 * than 0, or that which the solver estimates by its two grids, by bands of radii. The tolerance
 * chooses the solver's grids; the error is stated, whatever the tolerance. Beyond the reach the error
 * grows as core_transport_reach() says.
 */
#include "core/kernels.h"

/* Panels have the same width within a segment. Segments begin where the table of solutions has an
 * edge, as the slope of its R jumps there. */
enum { SEGMENTS = 5 };

/* Positions in the table that preparation makes; lengths are in mean free paths. */
enum coefficient {
  MFP_PER_MM,
  KAPPA,
  PANELS,
  R_SCALE, /* sigma_t'^2 */
  SLOPE_SCALE,
  LIMIT, /* limit of the cdf at infinity: 1, or 0 if nothing scatters */
  FIRST_X,
  LAST_X,
  /* for each segment of ln x: where it begins (INFINITY if there is none), its first panel, and ln x
   * in units of a panel's width there: 1 / width */
  BEGINS,
  FIRST_PANEL = BEGINS + SEGMENTS,
  PER_PANEL = FIRST_PANEL + SEGMENTS,
  /* STEEPER and FADING describe R beyond LAST_X relative to a dipole's diffusion, and one of them
   * is 0. STEEPER: R falls by this power of 1 / x more. */
  STEEPER = PER_PANEL + SEGMENTS,
  /* FADING: ln R falls by FADING (1 - (LAST_X / x)^2) / 2 more than a dipole's diffusion */
  FADING,
  /* d ln R / d ln sigma is a factor times (2 + d ln R / d ln x) plus another times a series: */
  SCALE_OF_A,      /* 1 - a, or 0 of layers */
  SCALE_OF_S,      /* a, or 0 of layers */
  SIGN_OF_S,       /* factor of the series for sigma_s: -1, or 1 of layers */
  KAPPA_BY_SERIES, /* what kappa contributes to the series: its derivative by ln rho; 0 of layers */
  /* positions of the series for sigma_a and for sigma_s, TERMS for each panel: both dL / d ln rho, or
   * of layers dL / d ln sigma; 0 if there are none */
  BY_SIGMA_A,
  BY_SIGMA_S,
  ENERGY, /* position of the table of the energy */
  BELOW,  /* position of the same table of T; 0: T is 0 */
  SERIES, /* TERMS coefficients of L for each panel */
};

enum { TERMS = 16 };

#ifdef CORE_ISA

#include "core/kernel.h"

#if CORE_REAL == 64

#include "core/models/energy.h"

/* The values of a panel's Legendre series and of its derivative, by Clenshaw's recurrence. */
struct series {
  double value;
  double slope; /* derivative by s, which runs from -1 to 1 in the panel */
};

/* at: position of the series in c. */
static inline struct series sum_series(const double *c, int64_t at, double s) {
  double next = 0, after = 0, next_slope = 0, after_slope = 0;
  for (int k = TERMS - 1; k >= 1; k--) {
    const double up = (2 * k + 1) / (k + 1.0);
    const double down = (k + 1.0) / (k + 2);
    const double value = c[at + k] + up * s * next - down * after;
    const double slope = up * real_fma(s, next_slope, next) - down * after_slope;
    after = next;
    next = value;
    after_slope = next_slope;
    next_slope = slope;
  }
  return (struct series){real_fma(s, next, real_fma(-0.5, after, c[at])),
                         real_fma(s, next_slope, real_fma(-0.5, after_slope, next))};
}

/* L = ln(x R) + kappa x at a radius, and its derivative by ln x. */
struct profile {
  double x;   /* radius in mean free paths, at most 1e100 */
  double far; /* x divided by the true radius, at most 1 */
  double value;
  double slope;
  double panel;
  double s; /* position in the panel, from -1 to 1 */
};

static inline struct profile look(const double *c, double r) {
  const double true_x = r * c[MFP_PER_MM] + 0; /* adding 0 turns -0 into 0 */
  const double x = real_min(true_x, 1e100);
  const double kept = real_min(real_max(x, c[FIRST_X]), c[LAST_X]);
  const double ln_x = real_log(kept, 0);
  double begin = c[BEGINS], first = c[FIRST_PANEL], per_panel = c[PER_PANEL];
  for (int i = 1; i < SEGMENTS; i++) {
    const double begins = c[BEGINS + i], firsts = c[FIRST_PANEL + i], per_panels = c[PER_PANEL + i];
    const bool behind = ln_x >= begins;
    begin = behind ? begins : begin;
    first = behind ? firsts : first;
    per_panel = behind ? per_panels : per_panel;
  }
  const double y = real_fma(ln_x - begin, per_panel, first);
  const double panel = real_floor(real_max(real_min(y, c[PANELS] - 1), 0));
  const double s = real_max(real_min(2 * (y - panel) - 1, 1), -1);
  const struct series sum = sum_series(c, SERIES + real_index(panel) * TERMS, s);
  const double kx = c[KAPPA] * x;
  const double kl = c[KAPPA] * c[LAST_X];
  const double power = 2 + c[STEEPER];
  const double nearness = c[LAST_X] / real_max(x, c[LAST_X]);
  const double faded = nearness * nearness;
  const double beyond = real_log((1 + kx) / (1 + kl), 0) -
                        power * real_log(real_max(x / c[LAST_X], 1), 0) -
                        0.5 * c[FADING] * (1 - faded);
  const bool inside = x >= c[FIRST_X] && x <= c[LAST_X];
  return (struct profile){
      .x = x,
      .far = x < true_x ? x / true_x : 1,
      .value = x > c[LAST_X] ? sum.value + beyond : sum.value,
      .slope = inside          ? sum.slope * (2 * per_panel)
               : x > c[LAST_X] ? kx / (1 + kx) - power - c[FADING] * faded
                               : 0,
      .panel = panel,
      .s = s,
  };
}

/* Returns scale e^(L - kappa x), written so that no factor overflows; the result may underflow. */
static inline double exponential(double scale, const double *c, struct profile p) {
  const double shift = real_max(p.value, 0);
  const double up = 1 / real_exp(-shift).exp;
  return real_times_exp(scale * up, real_min(p.value, 0) - c[KAPPA] * p.x, 0) * (p.far * p.far);
}

static inline double transport_R(const double *c, double r) {
  const struct profile p = look(c, r);
  const double R = exponential(c[R_SCALE], c, p) / p.x * p.far;
  return c[LIMIT] > 0 ? R : 0;
}

/* Returns dR/dr, from dR/dx = R / x (d ln(x R) / d ln x - 1). */
static inline double transport_slope(const double *c, double r) {
  const struct profile p = look(c, r);
  const double steepness = 1 + c[KAPPA] * p.x - p.slope;
  const double slope = -(exponential(c[SLOPE_SCALE], c, p) * steepness / p.x) / p.x * p.far;
  return c[LIMIT] > 0 ? slope : 0;
}

static inline double transport_ln_R(const double *c, double r) {
  const struct profile p = look(c, r);
  const double ln_R = p.value - c[KAPPA] * p.x + real_log(c[R_SCALE], 0);
  const double near = real_log(real_max(p.x, 1e-300), 0);
  const double bounded = p.x < 1e100 ? ln_R - near : -(double)INFINITY;
  const double any = p.x > 0 ? bounded : (double)INFINITY;
  return c[LIMIT] > 0 ? any : -(double)INFINITY;
}

static inline double transport_T(const double *c, double r) {
  const double T = transport_R(&c[(size_t)c[BELOW]], r);
  return c[BELOW] > 0 ? T : 0;
}

static inline double transport_cdf(const double *c, double r) {
  const double cdf = energy_cdf(&c[(size_t)c[ENERGY]], r);
  return c[LIMIT] > 0 ? cdf : 0;
}

/* Returns 2 + d ln R / d ln x. */
static inline double by_scale(const double *c, struct profile p) {
  return 1 + p.slope - c[KAPPA] * p.x;
}

/* Returns the derivative of ln R whose series is at this position. */
static inline double by_series(const double *c, double position, struct profile p) {
  const double last = c[LAST_X], beyond = real_max(p.x, last);
  const double moved = beyond / (1 + c[KAPPA] * beyond) - last / (1 + c[KAPPA] * last);
  return sum_series(c, (int64_t)position + real_index(p.panel) * TERMS, p.s).value +
         c[KAPPA_BY_SERIES] * (moved - p.x);
}

static inline double transport_by_sigma_a(const double *c, double r) {
  const struct profile p = look(c, r);
  const double by = real_fma(c[SCALE_OF_A], by_scale(c, p), by_series(c, c[BY_SIGMA_A], p));
  const double finite = p.far > 0 ? by : 0;
  return c[LIMIT] > 0 ? finite : 0;
}

static inline double transport_by_sigma_s(const double *c, double r) {
  const struct profile p = look(c, r);
  const double series = c[SIGN_OF_S] * by_series(c, c[BY_SIGMA_S], p);
  const double by = real_fma(c[SCALE_OF_S], by_scale(c, p), series);
  const double finite = p.far > 0 ? by : 0;
  return c[LIMIT] > 0 ? finite : 0;
}

CORE_KERNEL(eval_R, transport_R)
CORE_KERNEL(eval_T, transport_T)
CORE_KERNEL(eval_cdf, transport_cdf)
CORE_KERNEL(eval_slope, transport_slope)
CORE_KERNEL(eval_ln_R, transport_ln_R)

CORE_KERNEL(eval_by_sigma_a, transport_by_sigma_a)
CORE_KERNEL(eval_by_sigma_s, transport_by_sigma_s)

CORE_KERNEL_TABLE(transport, CORE_KERNELS_OF_ALL, .evaluate[CORE_ELEMENTWISE_T] = eval_T,
                  .evaluate[CORE_ELEMENTWISE_BY_SIGMA_A] = eval_by_sigma_a,
                  .evaluate[CORE_ELEMENTWISE_BY_SIGMA_S] = eval_by_sigma_s);

#else
CORE_KERNEL_TABLE_NONE(transport);
#endif

#else /* what follows prepares a profile, and is compiled once for all instruction sets */

#include <assert.h>
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define CORE_REAL 64
#include "core/energy.h"
#include "core/kernel.h"
#include "core/legendre.h"
#include "core/model_error.h"
#include "core/solver/solver.h"
#include "core/transport/decay.h"
#include "core/transport/table.h"

#define FIRST 1e-10
#define LAST 1e4
#define ENERGY_FIRST 1e-8 /* below it R is in proportion to 1 / x for the energy within */
#define LAST_EXPONENT 30.0
#define LAST_SOLVED 200.0 /* beyond, solutions lose digits, and R is diffusion */
#define PANEL_WIDTH 0.75  /* largest width of a panel in ln x, but for the table's first one */
#define LEAST_WIDTH 1e-3  /* least width of a segment in ln x */
#define SERIES_ERROR 1e-8
/* cost of one value in kernel evaluations of a dipole, measured with `build/bench kernel` */
#define COST 8

enum { PANELS_MAX = 48 };

/* ---- the domain ------------------------------------------------------------------------------- */

#define G_LEAST (-0.98)
#define G_MOST 0.99
#define RATIO_MOST 1000.0       /* largest sigma_a / sigma_s' */
#define RATIO_MOST_STORED 100.0 /* the same of the table */

static bool wants_derivatives(const core_inputs *inputs) {
  return !isnan(inputs->parameters->value[CORE_PARAMETER_DERIVATIVES]);
}

/* Bevilacqua and Depeursinge 1999: R beyond half a mean free path depends on the phase function by
 * sigma_s' and gamma. */
core_medium core_transport_medium(const core_medium *medium, double gamma) {
  core_medium other = *medium;
  if (!isnan(gamma)) {
    other.g = gamma - 1;
    other.sigma_s_per_mm = medium->sigma_s_per_mm * (1 - medium->g) / (2 - gamma);
  }
  return other;
}

/* Returns whether a medium has several layers, or one layer of finite thickness. */
static bool is_layered(const core_inputs *inputs) {
  return inputs->medium->thickness_mm > 0;
}

/* Returns whether R and the cdf are those of the light that leaves below. */
static bool is_transmitted(const core_inputs *inputs) {
  return (inputs->variant & CORE_SLAB_TRANSMITTED) != 0;
}

static core_medium medium_of(const core_inputs *inputs) {
  return core_transport_medium(inputs->medium, inputs->parameters->value[CORE_PARAMETER_GAMMA]);
}

static double albedo_of(const core_medium *medium) {
  return medium->sigma_s_per_mm * (1 - medium->g) / core_sigma_t_prime(medium);
}

/* Returns the share of extinction that is absorption. Next to white an albedo has too few digits to
 * say it. */
static double absorbed_of(const core_medium *medium) {
  return medium->sigma_a_per_mm / core_sigma_t_prime(medium);
}

static void take_layers(const core_medium *medium, uint32_t count, solver_layer *layer) {
  for (uint32_t i = 0; i < count; i++) {
    const core_medium *from = &medium[i];
    layer[i] = (solver_layer){from->sigma_a_per_mm, from->sigma_s_per_mm, from->g, from->eta,
                              from->thickness_mm > 0 ? from->thickness_mm : (double)INFINITY};
  }
}

/* Returns the least sigma_a of the layers per reduced mean free path of the first one. */
static double absorbs_least_of(const core_inputs *inputs) {
  double least = inputs->medium[0].sigma_a_per_mm;
  for (uint32_t i = 1; i < inputs->parameters->layer_count; i++) {
    least = fmin(least, inputs->medium[i].sigma_a_per_mm);
  }
  return least / core_sigma_t_prime(inputs->medium);
}

static double eta_below_of(const core_inputs *inputs) {
  return core_parameter_or(inputs, CORE_PARAMETER_ETA_BELOW, 1);
}

static bool scatters(const core_inputs *inputs) {
  bool any = false;
  for (uint32_t i = 0; i < inputs->parameters->layer_count; i++) {
    any |= inputs->medium[i].sigma_s_per_mm > 0;
  }
  return any;
}

/* The smallest and the largest thickness of a layer, in mean free paths of the layer. */
#define LAYER_LEAST 1e-4
#define LAYER_MOST 1e4

static core_fault check_layers(const core_inputs *inputs) {
  const uint32_t count = inputs->parameters->layer_count;
  for (uint32_t i = 0; i < count; i++) {
    const core_medium *layer = &inputs->medium[i];
    const double mfps = layer->thickness_mm * core_sigma_t_prime(layer);
    if (layer->thickness_mm > 0 && !(mfps >= LAYER_LEAST && mfps <= LAYER_MOST)) {
      return (core_fault){
          "thickness", "1e-4 to 1e4 mean free paths; one is 1 / (sigma_a + sigma_s (1 - g)) mm", i};
    }
  }
  if (!isnan(inputs->parameters->value[CORE_PARAMETER_GAMMA])) {
    return (core_fault){"gamma", "nothing with layers: it is of one half space", 0};
  }
  solver_layer layer[CORE_LAYERS_MAX];
  take_layers(inputs->medium, count, layer);
  return scatters(inputs) ? solver_layers_check(layer, count, eta_below_of(inputs))
                          : (core_fault){0};
}

core_fault core_transport_check(const core_inputs *inputs, core_radii_range *radii) {
  (void)radii;
  const core_medium medium = medium_of(inputs);
  if (!(medium.eta >= TRANSPORT_ETA_MIN && medium.eta <= TRANSPORT_ETA_MAX)) {
    return (core_fault){"eta", "0.25 to 4 with transport", 0};
  }
  if (core_parameter_or(inputs, CORE_PARAMETER_TOLERANCE, 1) < CORE_TOLERANCE_FINEST) {
    return (core_fault){"tolerance", "1e-8 to 1 with transport", 0};
  }
  const double layer = core_parameter_or(inputs, CORE_PARAMETER_DERIVATIVE_LAYER, 1);
  if (layer > inputs->parameters->layer_count || layer > floor(layer)) {
    return (core_fault){"derivative_layer", "an integer, 1 to the number of layers", 0};
  }
  const uint32_t last = inputs->parameters->layer_count - 1;
  if (is_transmitted(inputs) && !(inputs->medium[last].thickness_mm > 0)) {
    return (core_fault){"thickness", "above 0 mm: light leaves below this model's last layer",
                        last};
  }
  if (is_layered(inputs)) {
    return check_layers(inputs);
  }
  if (!(medium.sigma_s_per_mm > 0)) {
    return (core_fault){0};
  }
  if (!(medium.g >= G_LEAST && medium.g <= G_MOST)) {
    return isnan(inputs->parameters->value[CORE_PARAMETER_GAMMA])
               ? (core_fault){"g", "-0.98 to 0.99 with transport", 0}
               : (core_fault){"gamma", "0.02 to 1.99 with transport", 0};
  }
  const double scatters = medium.sigma_s_per_mm * (1 - medium.g);
  return medium.sigma_a_per_mm <= RATIO_MOST * scatters * (1 + 1e-12)
             ? (core_fault){0}
             : (core_fault){"sigma_a", "0 to 1000 sigma_s (1 - g) with transport", 0};
}

static bool is_stored(const core_medium *medium) {
  const transport_table *table = transport_table_shipped();
  return table != NULL && transport_table_covers(table, albedo_of(medium), medium->g, medium->eta);
}

bool core_transport_is_stored(const core_medium *medium) {
  return !(medium->sigma_s_per_mm > 0) || is_stored(medium);
}

core_fault core_transport_stored_check(double g, double eta) {
  const core_medium medium = {1, 1 / (1 - g), g, eta}, other = {1, 1, 0, eta};
  return is_stored(&medium)   ? (core_fault){0}
         : !is_stored(&other) ? (core_fault){"eta", "0.7 to 2.2 with transport", 0}
                              : (core_fault){"g", "-0.5 to 0.95 with transport", 0};
}

double core_transport_ratio_most(double g, double eta) {
  const core_medium medium = {1, 1 / (1 - g), g, eta};
  return is_stored(&medium) ? RATIO_MOST_STORED : RATIO_MOST;
}

/* ---- errors ----------------------------------------------------------------------------------- */

/* Next to eta = 1 the table is less exact far from the source in media that absorb: there R changes
 * by half a percent between eta = 1 and 1.0001, and the table's nodes do not follow. It is off by
 * up to 1.5e-5 at the end of the reach. */
#define TABLE_NEAR_1 1.6e-5
#define TABLE_IS_NEAR_1 1e-4

/* The table extrapolates to media that absorb less than this share, with an error of up to 5e-6
 * more. */
#define TABLE_WHITE 6e-6
#define TABLE_IS_WHITE 1e-6

/* The error of dR/dr from the table of solutions is up to 20 times that of R (`make truth`). */
#define TABLE_SLOPE 32.0

/* For g other than 0 dR/dr jumps where panels of the table meet: at x = 1 it is off by up to 5e-3 (24
 * media against core/solver/). */
#define TABLE_SLOPE_JUMPS 1e-2

/* Errors of derivatives, in errors of R: those of a solution change slowly with the radius and with
 * the medium (tests/accuracy/test_transport_solved.c). */
#define DERIVATIVE 4.0
/* error of a central difference with steps of LN_RATIO_STEP_SOLVED */
#define DIFFERENCE_ERROR 1e-4

/* Returns the radius, in mean free paths, where R of a medium that the table covers has fallen below
 * TRANSPORT_TABLE_R_LEAST, by a factor of up to 30, or FARTHEST if that is nearer. R is at most e^c (1 +
 * kappa x) e^(-kappa x) / x^3, as in diffusion; c was taken from the table. Newton's steps come from
 * below. */
#define FARTHEST 100.0
static double radius_of_R_least(double albedo, double eta, double kappa) {
  const double dark = -real_log(albedo, 0);
  const double c =
      fmin(0.25, 2 - 6 * dark / (1 + 0.3 * dark) - 0.9 * dark * sqrt(fmax(eta - 1, 0)));
  const double fallen = c - real_log(TRANSPORT_TABLE_R_LEAST, 0);
  double x = 1;
  for (int step = 0; step < 12 && x < FARTHEST; step++) {
    const double kx = kappa * x;
    x += x * (fallen - kx - 3 * real_log(x, 0) + real_log(1 + kx, 0)) / (kx + 3 - kx / (1 + kx));
  }
  return fmin(x, FARTHEST);
}

static bool is_isotropic(const core_medium *medium) {
  return !(medium->g < 0 || medium->g > 0);
}

/* How fast the error grows beyond a reach where R has fallen below TRANSPORT_TABLE_R_LEAST. */
static double growth_of(double kappa) {
  return 0.015 + 4 * kappa * kappa;
}

/* For g other than 0 the reach ends about where R falls below TRANSPORT_TABLE_R_LEAST, or at FARTHEST,
 * so that the profile's last band of radii, from 10 mean free paths on, does not state the error of
 * still larger radii. The growth is an upper bound of what was measured against the solver up to 30
 * decay lengths, where R is above 1e-17. */
core_reach core_transport_reach(const core_medium *medium) {
  const double sigma_t_prime = core_sigma_t_prime(medium);
  const double albedo = albedo_of(medium), kappa = transport_kappa(albedo);
  if (!is_isotropic(medium) && is_stored(medium)) {
    return (core_reach){
        .most_mm = radius_of_R_least(albedo, medium->eta, kappa) / sigma_t_prime,
        .growth = growth_of(kappa),
    };
  }
  return (core_reach){.most_mm = 1 / (kappa / LAST_EXPONENT + 1 / LAST) / sigma_t_prime,
                      .growth = fmin(0.5, kappa + 1e-4)};
}

/* The cdf and the pdf have the error of R and that of the energy that they are divided by. */
static void set_all(core_added_errors *added) {
  for (size_t i = 0; i <= CORE_ERROR_BANDS; i++) {
    added->all = fmax(added->all, 2 * added->banded[i]);
  }
}

void core_transport_added_errors(const core_medium *medium, core_added_errors *added) {
  *added = (core_added_errors){{0}, 0};
  const transport_table *table = transport_table_shipped();
  if (is_isotropic(medium) || !is_stored(medium)) {
    return;
  }
  const size_t bands = CORE_ERROR_BANDS;
  /* Beyond the reach core_error_beyond() is added. */
  const double reach = core_transport_reach(medium).most_mm * core_sigma_t_prime(medium);
  for (size_t i = 0; i < bands; i++) {
    const double least = i == 0 ? 0 : core_error_edges_mfp[i];
    const double most =
        i + 1 == bands ? fmax(least, reach) : core_error_edges_mfp[i + 1] * (1 - 1e-6);
    added->banded[i] =
        transport_table_error(table, albedo_of(medium), medium->g, medium->eta, least, most);
  }
  added->banded[bands] = transport_table_total_error(table, medium->g);
  set_all(added);
}

static double isotropic_error(const transport_table *table) {
  return transport_table_error(table, 0.5, 0, 1, 0, INFINITY) + SERIES_ERROR;
}

static double error_of_R(const transport_table *table, const core_medium *medium) {
  return isotropic_error(table) + (fabs(medium->eta - 1) < TABLE_IS_NEAR_1 ? TABLE_NEAR_1 : 0) +
         (absorbed_of(medium) < TABLE_IS_WHITE ? TABLE_WHITE : 0);
}

double core_transport_table_error(const core_medium *medium) {
  const transport_table *table = transport_table_shipped();
  return table != NULL ? error_of_R(table, medium) : (double)INFINITY;
}

bool core_transport_is_looked_up(const core_medium *medium, double tolerance) {
  if (!core_transport_is_stored(medium) || !(medium->sigma_s_per_mm > 0)) {
    return core_transport_is_stored(medium);
  }
  core_added_errors added;
  core_transport_added_errors(medium, &added);
  double error = 0;
  for (size_t i = 0; i < CORE_ERROR_BANDS; i++) {
    error = fmax(error, added.banded[i]);
  }
  return is_isotropic(medium) ||
         !(tolerance < error + error_of_R(transport_table_shipped(), medium));
}

/* This is more than the error of R. */
static double error_of_slope(const transport_table *table) {
  return isotropic_error(table) * TABLE_SLOPE;
}

double core_transport_slope_error(double g) {
  const transport_table *table = transport_table_shipped();
  return table == NULL ? 0 : g < 0 || g > 0 ? TABLE_SLOPE_JUMPS : error_of_slope(table);
}

/* ---- sources ---------------------------------------------------------------------------------- */

/* Where a profile comes from: a medium of the table, a solution of a half space, or a solution of
 * layers. */
struct source {
  const core_medium *medium;
  const transport_series *series;  /* of the table, else NULL */
  const solver_solution *solution; /* else NULL */
  const solver_layers *layers;     /* else NULL */
  size_t side;          /* index of the side of the layers where light leaves: top or bottom */
  double absorbs_least; /* least sigma_a of the layers, per reduced mean free path of the first */
  double kappa;
  /* NULL, or true as soon as nobody wants the values, which are unknown then */
  const atomic_bool *stop;
};

/* Returns R of a solution at x mean free paths. */
static transport_number solved_at(const struct source *source, double x) {
  if (solver_stops(source->stop)) {
    return (transport_number){0, (double)INFINITY};
  }
  if (source->layers == NULL) {
    return solver_at(source->solution, 0, x);
  }
  const double mfp_mm = 1 / core_sigma_t_prime(source->medium), area = mfp_mm * mfp_mm;
  const transport_number at = solver_layers_at(source->layers, source->side, x * mfp_mm);
  return (transport_number){at.value * area, at.error * area};
}

/* Less absorption does not show in the albedo. */
#define LEAST_ABSORBED 0x1p-40

static double kappa_of(const core_medium *medium) {
  const double absorbed = absorbed_of(medium);
  return absorbed < LEAST_ABSORBED ? sqrt(3 * absorbed)
         : is_isotropic(medium)    ? transport_kappa(albedo_of(medium))
                                   : transport_anisotropic_kappa(albedo_of(medium), medium->g);
}

/* Returns the albedo at which the table is evaluated. */
static double known_albedo(const core_medium *medium) {
  return is_isotropic(medium) ? fmin(albedo_of(medium), 1 - 0x1p-53) : albedo_of(medium);
}

static void look_up(const core_medium *medium, transport_series *series, struct source *source) {
  transport_table_look_up(transport_table_shipped(), known_albedo(medium), medium->g, medium->eta,
                          series);
  /* The series contains kappa. Computing it again for anisotropic scattering would take ten times
   * as long as the look-up. */
  const bool found = !is_isotropic(medium) && absorbed_of(medium) >= LEAST_ABSORBED;
  *source = (struct source){
      .medium = medium, .series = series, .kappa = found ? series->kappa : kappa_of(medium)};
}

static double ratio_of(const core_medium *medium) {
  return fmin(medium->sigma_a_per_mm / (medium->sigma_s_per_mm * (1 - medium->g)), RATIO_MOST);
}

/* Enters an error at a radius into the bands next to it. */
static void enter_error(double error, double x, core_added_errors *added) {
  const double apart = 1.1; /* points are closer */
  for (size_t i = 0; i < CORE_ERROR_BANDS; i++) {
    const double least = i == 0 ? 0 : core_error_edges_mfp[i];
    const double most = i + 1 == CORE_ERROR_BANDS ? (double)INFINITY : core_error_edges_mfp[i + 1];
    if (x * apart >= least && x <= most * apart) {
      added->banded[i] = fmax(added->banded[i], error);
    }
  }
}

/* Sets L[i] = ln(x R) + kappa x at y[i] = ln x, in ascending order. added: where the errors of a solution
 * are entered, or NULL. */
static void look_at(const struct source *source, const double y[TERMS], double L[TERMS],
                    core_added_errors *added) {
  if (source->series != NULL) {
    transport_series_Q(source->series, TERMS, y, L);
  }
  for (int i = 0; i < TERMS; i++) {
    const double x = real_exp_signed(y[i]);
    if (source->series != NULL) {
      L[i] += source->series->ln_albedo + real_log(fma(source->kappa, x, 1), 0);
      continue;
    }
    const transport_number at = solved_at(source, x);
    L[i] = real_log(fmax(x * at.value, 1e-300), 0) + source->kappa * x;
    if (added != NULL) {
      enter_error(at.error / fmax(at.value, 1e-300), x, added);
    }
  }
}

/* The panels of a profile and the values of L at their Gauss points, in ascending order. */
struct panels {
  struct segment {
    double begin; /* difference in ln x */
    double width; /* of a panel */
    size_t panels;
  } segment[SEGMENTS]; /* those that are not used have no panels */
  size_t segments;
  size_t count;
  double y[PANELS_MAX][TERMS];
  double L[PANELS_MAX][TERMS];
  bool joined; /* to be joined, as the table is not smooth at its edges */
  bool fades;  /* beyond the last radius R continues like the diffusion of white media */
};

/* Sets y to the Gauss points of a panel, in ascending order. */
static void set_points(double begin, double width, double y[TERMS]) {
  for (int i = 0; i < TERMS; i++) {
    const int node = i < TERMS / 2 ? TERMS - 2 - 2 * i : 2 * i - TERMS + 1;
    y[i] = fma(width, core_gauss_node(node), begin);
  }
}

/* Sets `series` to the Legendre series through values at the points of set_points(). */
static void fit_values(const double value[TERMS], double series[TERMS]) {
  double by_node[TERMS];
  for (int i = 0; i < TERMS; i++) {
    by_node[i < TERMS / 2 ? TERMS - 2 - 2 * i : 2 * i - TERMS + 1] = value[i];
  }
  core_legendre_fit(by_node, series);
}

/* Adds panels of the same width from `begin` on. */
static void add_segment(struct panels *panels, double begin, double width, size_t count) {
  panels->segment[panels->segments++] = (struct segment){begin, width, count};
  for (size_t k = 0; k < count; k++) {
    set_points(fma((double)k, width, begin), width, panels->y[panels->count++]);
  }
}

static void look_at_panels(const struct source *source, struct panels *panels,
                           core_added_errors *added) {
  for (size_t i = 0; i < panels->count; i++) {
    look_at(source, panels->y[i], panels->L[i], added);
  }
}

/* Lays panels between the edges of the table. The first one, up to 1e-3 mean free paths, is the
 * table's own, whose series has fewer terms. */
static void lay_panels(struct panels *panels, const double edges[TRANSPORT_TABLE_PANELS + 1],
                       double ln_last) {
  double begin = edges[0];
  for (int i = 1; i <= TRANSPORT_TABLE_PANELS + 1; i++) {
    const double end = i <= TRANSPORT_TABLE_PANELS ? edges[i] : ln_last;
    if (end > begin + LEAST_WIDTH && (end < ln_last - LEAST_WIDTH || end == ln_last)) {
      const double count = i == 1 ? 1 : ceil((end - begin) / PANEL_WIDTH);
      add_segment(panels, begin, (end - begin) / count, (size_t)count);
      begin = end;
    }
  }
}

static const struct segment *last_segment(const struct panels *panels) {
  return &panels->segment[panels->segments - 1];
}

static double last_of(const struct panels *panels) {
  const struct segment *segment = last_segment(panels);
  return real_exp_signed(fma((double)segment->panels, segment->width, segment->begin));
}

/* ---- the profile's table ---------------------------------------------------------------------- */

/* share: factor of R; 0 if nothing scatters. */
static void set_scales(double *c, double sigma_t_prime, double share) {
  c[MFP_PER_MM] = sigma_t_prime;
  c[LIMIT] = share > 0;
  c[R_SCALE] = share * (sigma_t_prime * sigma_t_prime);
  c[SLOPE_SCALE] = c[R_SCALE] * sigma_t_prime;
}

/* Returns by how much the slope dL / d ln x at the end of a panel is less than that of a dipole's
 * diffusion. kappa_last: kappa times the radius there. */
static double steeper(const double *series, double width, double kappa_last) {
  double slope = 0; /* derivative by s at s = 1; that of P_k is k (k + 1) / 2 */
  for (int k = TERMS - 1; k > 0; k--) {
    slope = fma(0.5 * k * (k + 1), series[k], slope);
  }
  return kappa_last / (1 + kappa_last) - 2 - slope * (2 / width);
}

static void set_series(const struct panels *panels, double kappa, double *c) {
  const double last = last_of(panels);
  c[KAPPA] = kappa;
  c[PANELS] = (double)panels->count;
  c[FIRST_X] = real_exp_signed(panels->segment[0].begin);
  c[LAST_X] = last;
  size_t panel = 0;
  for (int k = 0; k < SEGMENTS; k++) {
    const struct segment *segment = &panels->segment[k];
    c[BEGINS + k] = segment->panels > 0 ? segment->begin : (double)INFINITY;
    c[FIRST_PANEL + k] = (double)panel;
    c[PER_PANEL + k] = segment->panels > 0 ? 1 / segment->width : 0;
    panel += segment->panels;
  }
  for (size_t i = 0; i < panels->count; i++) {
    fit_values(panels->L[i], &c[SERIES + i * TERMS]);
  }
  if (panels->joined) {
    transport_join_panels(panels->count, TERMS, &c[SERIES]);
  }
  const double more =
      steeper(&c[SERIES + (panels->count - 1) * TERMS], last_segment(panels)->width, kappa * last);
  c[STEEPER] = panels->fades ? 0 : more;
  c[FADING] = panels->fades ? more : 0;
}

/* The derivative by ln rho, or of layers by ln sigma: that of kappa, and that of L at the points of
 * the panels. */
struct derivative {
  double kappa;
  double L[PANELS_MAX][TERMS];
};

/* Makes the table of a profile that scatters and adds it to the preparation, whose albedo has been
 * set. derivatives: none, the one by ln rho, or those by ln sigma_a and by ln sigma_s. scaled: R has
 * to have the albedo for its energy. */
static core_fault fill_table(const core_inputs *inputs, const core_medium *medium,
                             const struct panels *panels, double kappa, const struct derivative *by,
                             size_t derivatives, bool scaled, core_preparation *preparation) {
  const double sigma_t_prime = core_sigma_t_prime(medium), mfp_mm = 1 / sigma_t_prime;
  const double first = ENERGY_FIRST;
  /* Less than 1e-12 of the energy lies beyond 40 decay lengths 1 / kappa, or beyond 1e12 mean free
   * paths. */
  const double energy_last = kappa * 1e12 > 40 ? fmax(40 / kappa, last_of(panels)) : 1e12;
  const size_t length = panels->count * TERMS;
  const size_t before_energy = SERIES + length + derivatives * length;
  preparation->table_bytes =
      (before_energy + core_energy_length(first * mfp_mm, energy_last * mfp_mm)) * sizeof(double);
  double *c = malloc(preparation->table_bytes);
  if (c == NULL) {
    return CORE_OUT_OF_MEMORY;
  }
  set_scales(c, sigma_t_prime, 1);
  set_series(panels, kappa, c);
  const bool by_ratio = derivatives < 2;
  c[SCALE_OF_A] = by_ratio ? absorbed_of(medium) : 0;
  c[SCALE_OF_S] = by_ratio ? 1 - absorbed_of(medium) : 0;
  c[SIGN_OF_S] = by_ratio ? -1 : 1;
  c[KAPPA_BY_SERIES] = derivatives > 0 ? by->kappa : 0;
  c[BY_SIGMA_A] = derivatives > 0 ? (double)(SERIES + length) : 0;
  c[BY_SIGMA_S] = derivatives > 0 ? (double)(SERIES + derivatives * length) : 0;
  for (size_t k = 0; k < derivatives; k++) {
    for (size_t i = 0; i < panels->count; i++) {
      fit_values(by[k].L[i], &c[SERIES + (1 + k) * length + i * TERMS]);
    }
  }
  c[ENERGY] = (double)before_energy;
  c[BELOW] = 0;
  const core_kernels_f64 *kernels = core_isa_kernels(inputs->isa, CORE_MODEL_TRANSPORT)->f64;
  const double energy =
      core_energy_build(kernels, c, first * mfp_mm, energy_last * mfp_mm, &c[before_energy]);
  if (scaled) {
    /* The albedo has its own table, which is more exact than that of R. */
    set_scales(c, sigma_t_prime, preparation->albedo / energy);
  }
  preparation->table = c;
  return (core_fault){0};
}

static core_fault fill_nothing(double sigma_t_prime, core_preparation *preparation) {
  preparation->table_bytes =
      (SERIES + 2 * TERMS + CORE_ENERGY_SERIES + CORE_ENERGY_TERMS) * sizeof(double);
  double *c = calloc(1, preparation->table_bytes);
  if (c == NULL) {
    return CORE_OUT_OF_MEMORY;
  }
  set_scales(c, sigma_t_prime, 0);
  c[PANELS] = 1;
  c[FIRST_X] = FIRST;
  c[LAST_X] = LAST;
  c[BY_SIGMA_A] = SERIES + TERMS;
  c[BY_SIGMA_S] = SERIES + TERMS;
  c[ENERGY] = SERIES + 2 * TERMS;
  double *energy = &c[SERIES + 2 * TERMS];
  energy[CORE_ENERGY_PANELS] = 1;
  energy[CORE_ENERGY_FIRST_MM] = 1;
  energy[CORE_ENERGY_PER_PANEL] = 1;
  preparation->table = c;
  return (core_fault){0};
}

static const core_fault stopped = {CORE_FIELD_STOPPED, "to be waited for", 0};

/* ---- derivatives ------------------------------------------------------------------------------ */

/* Differences of ln rho, or of ln sigma, for the derivatives: of a medium of the table, and of solved
 * ones. The second is larger, because the errors of two solutions differ by more. */
#define LN_RATIO_STEP 0x1p-15
#define LN_RATIO_STEP_SOLVED 0x1p-6
enum { DIFFERENCE_LEVEL = 3 }; /* the solver's grid of both neighbours of a half space */

/* Adds weight times kappa and L of a neighbouring medium to the derivative. like: the source of the medium
 * itself. level: the solver's grid. */
static core_fault add_neighbour(const core_inputs *inputs, const struct source *like,
                                const core_medium *medium, size_t level, double weight,
                                const struct panels *panels, struct derivative *by) {
  const uint32_t count = inputs->parameters->layer_count;
  const solver_phase phase = {.g = medium->g};
  transport_series series;
  solver_solution *solution = NULL;
  solver_layers *layers = NULL;
  struct source source = *like;
  core_fault fault = {0};
  if (like->series != NULL) {
    look_up(medium, &series, &source);
  } else if (like->layers != NULL) {
    solver_layer layer[CORE_LAYERS_MAX];
    take_layers(medium, count, layer);
    fault = solver_layers_solve_level(&layers, inputs->isa, layer, count, eta_below_of(inputs),
                                      level, inputs->stop);
    source.layers = layers;
  } else {
    fault = solver_solve_level(&solution, inputs->isa, ratio_of(medium), &phase, &medium->eta, 1,
                               level, NULL, false);
    source = (struct source){.medium = medium, .solution = solution, .kappa = kappa_of(medium)};
  }
  if (fault.field == NULL) {
    by->kappa += weight * source.kappa;
    for (size_t i = 0; i < panels->count; i++) {
      double L[TERMS];
      look_at(&source, panels->y[i], L, NULL);
      for (int k = 0; k < TERMS; k++) {
        by->L[i][k] += weight * L[k];
      }
    }
  }
  solver_free(solution);
  solver_layers_free(layers);
  return fault;
}

/* Sets *by by a difference between two media with another sigma_a, or sigma_s, of one layer. */
static core_fault differentiate(const core_inputs *inputs, const struct source *source,
                                const struct panels *panels, bool of_s, size_t level,
                                struct derivative *by) {
  const size_t at = (size_t)core_parameter_or(inputs, CORE_PARAMETER_DERIVATIVE_LAYER, 1) - 1;
  core_medium medium[CORE_LAYERS_MAX];
  memcpy(medium, source->medium, inputs->parameters->layer_count * sizeof *medium);
  double *sigma = of_s ? &medium[at].sigma_s_per_mm : &medium[at].sigma_a_per_mm;
  const double middle = *sigma;
  const double step = source->series != NULL ? LN_RATIO_STEP : LN_RATIO_STEP_SOLVED;
  *sigma = middle * real_exp_signed(step);
  /* Beyond the table, and beyond RATIO_MOST, nothing is known. */
  const bool one_sided = (source->series != NULL && !is_stored(medium)) ||
                         (source->solution != NULL && ratio_of(source->medium) > 0.9 * RATIO_MOST);
  const double above = one_sided ? 0 : step;
  core_fault fault = {0};
  *by = (struct derivative){0};
  for (int i = 0; i < 2 && middle > 0 && fault.field == NULL; i++) {
    *sigma = middle * real_exp_signed(i == 0 ? -step : above);
    fault = add_neighbour(inputs, source, medium, level, (i == 0 ? -1 : 1) / (above + step), panels,
                          by);
    fault = solver_stops(inputs->stop) ? stopped : fault;
  }
  return fault;
}

/* ---- by the table ----------------------------------------------------------------------------- */

/* Returns the albedo of a medium with this series. All light leaves a medium that absorbs none. The
 * table does not hold the totals of isotropic media that absorb less than TABLE_IS_WHITE: there (1 -
 * albedo) / albedo is in proportion to the root of what is absorbed, within 6e-6. For g other than 0
 * the total has an absolute error of 1e-8. */
static double albedo_of_series(const core_medium *medium, const transport_series *series) {
  const double absorbed = absorbed_of(medium);
  if (!is_isotropic(medium)) {
    return absorbed > 0 ? fmin(series->total, 1) : 1;
  }
  if (absorbed >= TABLE_IS_WHITE) {
    return series->total;
  }
  transport_series held;
  transport_table_look_up(transport_table_shipped(), 1 - TABLE_IS_WHITE, 0, medium->eta, &held);
  const double root = sqrt(absorbed / TABLE_IS_WHITE);
  return held.total / (held.total + (1 - held.total) * root);
}

/* Error of a difference between nearly white media, per mm: their albedos are rounded, which
 * changes the slope of kappa, and far away ln R is about ln(1 + kappa x) - kappa x. */
static double rounded_albedos_per_mm(const core_medium *medium, double kappa, double most_mm) {
  const double absorbed = absorbed_of(medium), per_mm = kappa * core_sigma_t_prime(medium);
  const double off = fmin(DBL_EPSILON / (absorbed * LN_RATIO_STEP), 1);
  return absorbed > 0 ? off * per_mm * (per_mm * most_mm / (1 + per_mm * most_mm)) : 0;
}

static core_fault prepare_stored(const core_inputs *inputs, const core_medium *medium,
                                 core_preparation *preparation) {
  const transport_table *table = transport_table_shipped();
  const bool isotropic = is_isotropic(medium);
  transport_series series;
  struct source source;
  look_up(medium, &series, &source);
  preparation->albedo = albedo_of_series(medium, &series);
  preparation->error = error_of_R(table, medium);
  preparation->slope_error = core_transport_slope_error(isotropic ? 0 : 1);
  core_transport_added_errors(medium, &preparation->added);
  preparation->reach = core_transport_reach(medium);
  const double error = preparation->error + preparation->added.all;
  preparation->derivative_error =
      isotropic ? error_of_slope(table) : fmax(DERIVATIVE * error, TABLE_SLOPE_JUMPS);
  preparation->derivative_error_per_mm =
      (isotropic ? 0 : error * source.kappa * core_sigma_t_prime(medium)) +
      rounded_albedos_per_mm(medium, source.kappa, preparation->reach.most_mm);
  if (inputs->only_albedo) {
    return (core_fault){0};
  }
  struct panels panels = {.joined = true};
  struct derivative by_ratio;
  lay_panels(&panels, isotropic ? series.edge : series.difference.edge,
             series.edge[TRANSPORT_TABLE_PANELS]);
  panels.fades = last_of(&panels) > 0.4 * LAST;
  look_at_panels(&source, &panels, NULL);
  const bool derivatives = wants_derivatives(inputs);
  const core_fault fault =
      derivatives ? differentiate(inputs, &source, &panels, false, 0, &by_ratio) : (core_fault){0};
  return fault.field != NULL ? fault
                             : fill_table(inputs, medium, &panels, source.kappa, &by_ratio,
                                          derivatives, !isotropic, preparation);
}

/* ---- by the solver ---------------------------------------------------------------------------- */

/* Returns the least y above `least` where R has fallen below TRANSPORT_TABLE_R_LEAST, which it has at
 * `most`. */
static double end_of(const struct source *source, double least, double most) {
  for (int step = 0; step < 20; step++) {
    const double y = 0.5 * (least + most);
    const bool fallen = solved_at(source, real_exp_signed(y)).value < TRANSPORT_TABLE_R_LEAST;
    *(fallen ? &most : &least) = y;
  }
  return least;
}

/* Returns the logarithm of the radius where R has fallen below TRANSPORT_TABLE_R_LEAST, or of
 * LAST_SOLVED. */
static double find_end(const struct source *source) {
  const double last = real_log(LAST_SOLVED, 0);
  for (double next = real_log(FIRST, 0) + PANEL_WIDTH; next < last; next += PANEL_WIDTH) {
    if (solved_at(source, real_exp_signed(next)).value < TRANSPORT_TABLE_R_LEAST) {
      return end_of(source, next - PANEL_WIDTH, next);
    }
  }
  return last;
}

/* Lays panels up to e^end, with their errors; none if that is not beyond FIRST. */
static void lay_panels_solved(const struct source *source, double end, struct panels *panels,
                              core_added_errors *added) {
  const double first = real_log(FIRST, 0);
  const double count = fmax(0, ceil((end - first) / PANEL_WIDTH) - 1);
  const double last = fma(count, PANEL_WIDTH, first);
  add_segment(panels, first, PANEL_WIDTH, (size_t)count);
  if (end > last + LEAST_WIDTH) {
    add_segment(panels, last, end - last, 1);
  }
  panels->fades = end == real_log(LAST_SOLVED, 0);
  look_at_panels(source, panels, added);
}

/* Sets the albedo and its error. */
static core_fault find_albedo(const core_inputs *inputs, const core_medium *medium,
                              core_preparation *preparation) {
  const solver_phase phase = {.g = medium->g};
  solver_total total;
  const core_fault fault =
      solver_totals(&total, inputs->isa, ratio_of(medium), &phase, &medium->eta, 1);
  if (fault.field == NULL) {
    const transport_number found = inputs->light == CORE_LIGHT_BEAM ? total.normal : total.diffuse;
    preparation->albedo = medium->sigma_a_per_mm > 0 ? fmin(found.value, 1) : 1;
    preparation->added.banded[CORE_ERROR_BANDS] = 2 * found.error / fmax(found.value, 1e-300);
  }
  return fault;
}

/* Sets the errors by band of radii of a profile from a solution. It leaves the errors of a profile
 * from the table. */
static void set_errors(const struct source *source, const struct panels *panels,
                       core_preparation *preparation) {
  const double sigma_t_prime = core_sigma_t_prime(source->medium);
  set_all(&preparation->added);
  preparation->error = SERIES_ERROR;
  const double error = SERIES_ERROR + preparation->added.all;
  preparation->slope_error = DERIVATIVE * error;
  preparation->derivative_error = DERIVATIVE * error + DIFFERENCE_ERROR;
  preparation->derivative_error_per_mm = error * source->kappa * sigma_t_prime;
  preparation->reach =
      (core_reach){.most_mm = last_of(panels) / sigma_t_prime, .growth = growth_of(source->kappa)};
}

/* A solution loses its digits far away, that of a half space where g is near -1. It is used up to the
 * largest radius, no smaller than the end by MUCH_NEARER, where its relative error is at most
 * DIGITS_LEFT, or DIGITS_LEAST where there is none (thin slabs); of a half space, which is stated
 * whatever its error, DIGITS_LEFT_HALF. Beyond, R is not known: the error grows to infinity within 8 %
 * of the radius. */
#define DIGITS_LEFT 0.0625
#define DIGITS_LEFT_HALF 0.5
#define DIGITS_LEAST 0.16
#define MUCH_NEARER 6.0 /* in ln x */
#define LOST_GROWTH 1000.0

/* Sets *end to the largest ln x that is used, and *growth to that of the reach if digits are lost
 * before R is negligible, else to 0. Returns false if no radius has enough digits: *end is the last one. */
static bool find_end_known(const struct source *source, double *end, double *growth) {
  const double most = find_end(source);
  const double left[] = {source->layers != NULL ? DIGITS_LEFT : DIGITS_LEFT_HALF, DIGITS_LEAST};
  for (size_t i = 0; i < sizeof left / sizeof left[0]; i++) {
    for (*end = most; *end > most - MUCH_NEARER; *end -= 0.5 * PANEL_WIDTH) {
      const transport_number at = solved_at(source, real_exp_signed(*end));
      if (at.error <= left[i] * at.value) {
        *growth = *end < most ? LOST_GROWTH : 0;
        return true;
      }
    }
  }
  *end = most;
  *growth = LOST_GROWTH;
  return false;
}

/* Beyond the last panel its error holds, and the reach adds to it. */
static void extend_errors(const struct source *source, double end, core_added_errors *added) {
  const transport_number last = solved_at(source, real_exp_signed(end));
  for (double x = real_exp_signed(end); x < 2 * core_error_edges_mfp[CORE_ERROR_BANDS - 1];
       x *= 1.1) {
    enter_error(last.error / last.value, x, added);
  }
}

static core_fault prepare_solved(const core_inputs *inputs, const core_medium *medium,
                                 double tolerance, core_preparation *preparation) {
  core_fault fault = find_albedo(inputs, medium, preparation);
  if (fault.field != NULL || inputs->only_albedo) {
    return fault;
  }
  const bool derivatives = wants_derivatives(inputs);
  const solver_phase phase = {.g = medium->g};
  solver_solution *solution;
  struct source source = {.medium = medium, .kappa = kappa_of(medium)};
  struct panels panels = {.joined = false};
  struct derivative by_ratio;
  double end, growth = 0;
  fault = solver_solve_until(&solution, inputs->isa, ratio_of(medium), &phase, medium->eta,
                             tolerance, inputs->stop);
  if (fault.field == NULL) {
    source.solution = solution;
    find_end_known(&source, &end, &growth);
    lay_panels_solved(&source, end, &panels, &preparation->added);
    if (growth > 0) {
      extend_errors(&source, end, &preparation->added);
    }
    fault = derivatives
                ? differentiate(inputs, &source, &panels, false, DIFFERENCE_LEVEL, &by_ratio)
                : fault;
  }
  solver_free(solution);
  if (fault.field != NULL) {
    return fault;
  }
  set_errors(&source, &panels, preparation);
  preparation->reach.growth = fmax(growth, preparation->reach.growth);
  return fill_table(inputs, medium, &panels, source.kappa, &by_ratio, derivatives, false,
                    preparation);
}

/* ---- layers ----------------------------------------------------------------------------------- */

_Static_assert((int)CORE_LAYERS_MAX == (int)SOLVER_LAYERS_MAX, "the solver takes as many layers");

/* Returns the kappa with which R of a dipole in diffusion, (1 + kappa x) e^(-kappa x) / x^3, has
 * the slope of R at the end of the panels; at least what the layer that absorbs least absorbs. R of
 * layers decays at a rate that depends on their thickness. */
static double kappa_at(const struct source *source, double end) {
  const double step = 0.125;
  const double near = solved_at(source, real_exp_signed(end - step)).value;
  const double far = solved_at(source, real_exp_signed(end)).value;
  const double steeper =
      near > far && far > 0 ? (real_log(near, 0) - real_log(far, 0)) / step - 3 : 0;
  const double at_end = steeper > 0 ? 0.5 * (steeper + sqrt(steeper * (steeper + 4))) /
                                          real_exp_signed(end - 0.5 * step)
                                    : 0;
  return fmax(at_end, source->absorbs_least);
}

/* The solver's coarser grid for differences of layers, for tolerances below FINE and from there on. The
 * other one is the next. */
#define FINE 3e-3
enum { LAYERS_LEVEL_FINE = 1, LAYERS_LEVEL = 0 };

/* Sets by[] to the derivatives by ln sigma_a and by ln sigma_s of one layer, with their errors. */
static core_fault differentiate_layers(const core_inputs *inputs, const struct source *source,
                                       const struct panels *panels, double tolerance,
                                       struct derivative by[2], core_preparation *preparation) {
  const size_t level = tolerance < FINE ? LAYERS_LEVEL_FINE : LAYERS_LEVEL;
  core_fault fault = {0};
  for (int of_s = 0; of_s < 2 && fault.field == NULL; of_s++) {
    struct derivative coarse;
    fault = differentiate(inputs, source, panels, of_s, level, &coarse);
    if (fault.field == NULL) {
      fault = differentiate(inputs, source, panels, of_s, level + 1, &by[of_s]);
    }
    for (size_t i = 0; i < panels->count * TERMS && fault.field == NULL; i++) {
      const double apart = by[of_s].L[i / TERMS][i % TERMS] - coarse.L[i / TERMS][i % TERMS];
      enter_error(DERIVATIVE * fabs(apart), real_exp_signed(panels->y[i / TERMS][i % TERMS]),
                  &preparation->derivative_added);
    }
  }
  preparation->derivative_error = DIFFERENCE_ERROR;
  preparation->derivative_error_per_mm =
      DIFFERENCE_ERROR * source->kappa * core_sigma_t_prime(source->medium);
  return fault;
}

/* Prepares a profile of the light that leaves on one side of the layers. total: its share. */
static core_fault prepare_side(const core_inputs *inputs, const solver_layers *layers, size_t side,
                               const transport_number *total, double tolerance,
                               core_preparation *preparation) {
  struct source source = {.medium = inputs->medium,
                          .layers = layers,
                          .side = side,
                          .absorbs_least = absorbs_least_of(inputs),
                          .stop = inputs->stop};
  const bool derivatives = wants_derivatives(inputs) && side == is_transmitted(inputs);
  struct panels panels = {.joined = false};
  struct derivative by[2];
  double end, growth = 0;
  if (find_end_known(&source, &end, &growth)) {
    source.kappa = kappa_at(&source, end);
    lay_panels_solved(&source, end, &panels, &preparation->added);
  }
  if (panels.count == 0) {
    return side == 0 ? (core_fault){"thickness",
                                    "thicker layers: R of these is not found; mc walks them", 0}
                     : (core_fault){"thickness",
                                    "other layers: T of these is not found; mc walks them", 0};
  }
  extend_errors(&source, end, &preparation->added);
  preparation->albedo = fmin(total->value, 1);
  preparation->added.banded[CORE_ERROR_BANDS] = total->error / fmax(total->value, 1e-300);
  set_errors(&source, &panels, preparation);
  preparation->reach.growth = fmax(growth, preparation->reach.growth);
  core_fault fault =
      derivatives ? differentiate_layers(inputs, &source, &panels, tolerance, by, preparation)
                  : (core_fault){0};
  fault = solver_stops(inputs->stop) ? stopped : fault;
  return fault.field != NULL ? fault
                             : fill_table(inputs, inputs->medium, &panels, source.kappa, by,
                                          derivatives ? 2 : 0, false, preparation);
}

/* Adds T to a profile of layers. */
static core_fault add_below(const core_inputs *inputs, const solver_layers *layers,
                            const transport_number *total, double tolerance,
                            core_preparation *preparation) {
  core_preparation below = {0};
  const core_fault fault = prepare_side(inputs, layers, 1, total, tolerance, &below);
  if (fault.field != NULL) {
    for (size_t i = 0; i <= CORE_ERROR_BANDS; i++) {
      preparation->T_added.banded[i] = (double)INFINITY;
    }
    set_all(&preparation->T_added);
    return strcmp(fault.field, CORE_FIELD_MEMORY) == 0 ? fault : (core_fault){0};
  }
  const size_t bytes = preparation->table_bytes + below.table_bytes;
  double *c = realloc(preparation->table, bytes);
  if (c != NULL) {
    preparation->table = c;
    c[BELOW] = (double)(preparation->table_bytes / sizeof(double));
    memcpy(&c[(size_t)c[BELOW]], below.table, below.table_bytes);
    preparation->table_bytes = bytes;
  }
  free(below.table);
  preparation->T_added = below.added;
  preparation->T_reach = below.reach;
  return c != NULL ? (core_fault){0} : CORE_OUT_OF_MEMORY;
}

static void note_balance(const solver_balance *of, core_preparation *to) {
  for (size_t i = 0; i < CORE_BALANCE_SHARES; i++) {
    const transport_number share = i < 2   ? of->out[i]
                                   : i < 4 ? (transport_number){of->unscattered[i - 2], 0}
                                           : of->absorbed[i - 4];
    to->balance[i] = share.value;
    to->balance_error = fmax(to->balance_error, share.error);
  }
}

static core_fault prepare_layers(const core_inputs *inputs, double tolerance,
                                 core_preparation *preparation) {
  const uint32_t count = inputs->parameters->layer_count;
  const size_t side = is_transmitted(inputs);
  solver_layers *solution;
  solver_balance balance;
  solver_layer layer[CORE_LAYERS_MAX];
  take_layers(inputs->medium, count, layer);
  core_fault fault = solver_layers_solve(&solution, inputs->isa, layer, count, eta_below_of(inputs),
                                         tolerance, inputs->stop);
  if (fault.field == NULL) {
    fault = solver_layers_balance(solution, inputs->isa, &balance);
  }
  if (fault.field == NULL) {
    note_balance(&balance, preparation);
    fault = prepare_side(inputs, solution, side, &balance.out[side], tolerance, preparation);
  }
  if (fault.field == NULL && side == 0 && inputs->medium[count - 1].thickness_mm > 0) {
    fault = add_below(inputs, solution, &balance.out[1], tolerance, preparation);
  }
  fault = solver_stops(inputs->stop) ? stopped : fault;
  if (fault.field != NULL) {
    free(preparation->table);
    preparation->table = NULL;
  }
  solver_layers_free(solution);
  return fault;
}

/* ---- preparing -------------------------------------------------------------------------------- */

/* Default tolerances of the solver. Layers take ten times as long for 1e-3. */
#define TOLERANCE 1e-3
#define LAYERS_TOLERANCE 1e-2

static core_fault prepare_any(const core_inputs *inputs, core_preparation *preparation) {
  const core_medium medium = medium_of(inputs);
  preparation->cost = COST;
  preparation->error = SERIES_ERROR;
  if (!scatters(inputs)) {
    return fill_nothing(core_sigma_t_prime(&medium), preparation);
  }
  const double usual = is_layered(inputs) ? LAYERS_TOLERANCE : TOLERANCE;
  const double asked = isinf(inputs->accepted) ? (double)NAN
                       : inputs->accepted > 0  ? fmax(inputs->accepted, TOLERANCE)
                                              : inputs->parameters->value[CORE_PARAMETER_TOLERANCE];
  const double tolerance = isnan(asked) ? usual : asked;
  if (is_layered(inputs)) {
    return prepare_layers(inputs, tolerance, preparation);
  }
  const bool any = inputs->accepted > 0 || inputs->only_albedo; /* the albedo's error is small */
  return inputs->light == CORE_LIGHT_BEAM &&
                 core_transport_is_looked_up(&medium, any ? (double)NAN : asked)
             ? prepare_stored(inputs, &medium, preparation)
             : prepare_solved(inputs, &medium, tolerance, preparation);
}

core_fault core_transport_prepare(const core_inputs *inputs, core_preparation *preparation) {
  const core_fault fault = prepare_any(inputs, preparation);
  if (fault.field == NULL && !is_layered(inputs)) {
    preparation->balance[0] = preparation->albedo;
    preparation->balance[4] = 1 - preparation->albedo;
    preparation->balance_error = preparation->error + preparation->added.banded[CORE_ERROR_BANDS];
  } else if (fault.field == NULL && !scatters(inputs)) {
    preparation->balance_error = (double)INFINITY; /* it is not computed */
  }
  return fault;
}

#endif
