/* Radiative transport itself: the model evaluates the deterministic solutions of core/transport/,
 * where the equations are.
 *
 * Preparation solves a medium once, at points of ln x (x is the radius in mean free paths 1 /
 * sigma_t'). The kernels evaluate Legendre series of
 *
 *   L(ln x) = ln(x R(x)) + kappa x
 *
 * in panels of ln x. Since 1 / x at the source and e^(-kappa x) far away are divided out, a series
 * of 16 terms is exact to half of TOLERANCE_LEAST. R stays positive between the points. The energy
 * within r is integrated from the same series (core/energy.h). The albedo is the solver's own
 * total.
 *
 * If a tolerance is given, or core_inputs allows it, preparation takes the profile from a table of
 * solutions (core/transport/table.h) instead of solving, provided that the table covers the medium
 * and is as accurate as asked.
 *
 * Anisotropic scattering (Henyey and Greenstein 1941, g from -0.5 to 0.95) always comes from that
 * table, which covers sigma_a up to 100 sigma_s' and eta from 0.7 to 2.2. Solving it would take
 * seconds. The table's error is larger than that for g = 0, whatever the tolerance, and is stated
 * by band of radii. Other media go through the similarity relation, with a note.
 *
 * Domain: eta from 0.25 to 4. Below FIRST mean free paths R is continued in proportion to 1 / x.
 * The last radius is LAST_EXPONENT / kappa or LAST mean free paths, whichever is less. Beyond it R
 * is continued in proportion to the diffusion of a dipole, (1 + kappa x) e^(-kappa x) / x^3, times
 * a factor that keeps the slope at the last radius. That factor is a power of x; if the last radius
 * is LAST, it is instead the next term of that diffusion, in 1 / x^2, which is as accurate as the
 * solution.
 *
 * Error, up to the last radius, where R is 1e-13 of its value at one mean free path: the tolerance,
 * relative (TOLERANCE by default, at least TOLERANCE_LEAST, half of which is for the series), or
 * the solver's own estimate where that is larger, which happens for albedos below about 1e-6.
 * Beyond the last radius the error grows as core_transport_reach() says. It was measured against
 * solutions to 110 / kappa (tests/accuracy/test_transport_far.c), where the continuation is off by
 * 0.4 at most, for an albedo of 0.01. With the table: the table's measured error plus
 * TOLERANCE_LEAST, where R is above TRANSPORT_TABLE_R_LEAST. For g other than 0 the table's error
 * by region is added (core_added_errors).
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
  R_SCALE,    /* sigma_t'^2 */
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
  SERIES, /* TERMS coefficients for each panel; the table of the energy follows them */
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

static inline struct series sum_series(const double *a, double s) {
  double next = 0, after = 0, next_slope = 0, after_slope = 0;
  for (int k = TERMS - 1; k >= 1; k--) {
    const double up = (2 * k + 1) / (k + 1.0);
    const double down = (k + 1.0) / (k + 2);
    const double value = a[k] + up * s * next - down * after;
    const double slope = up * real_fma(s, next_slope, next) - down * after_slope;
    after = next;
    next = value;
    after_slope = next_slope;
    next_slope = slope;
  }
  return (struct series){real_fma(s, next, real_fma(-0.5, after, a[0])),
                         real_fma(s, next_slope, real_fma(-0.5, after_slope, next))};
}

/* L = ln(x R) + kappa x at a radius, and its derivative by ln x. */
struct profile {
  double x;   /* radius in mean free paths, at most 1e100 */
  double far; /* x divided by the true radius, at most 1 */
  double value;
  double slope;
};

static inline struct profile look(const double *c, double r) {
  const double true_x = r * c[MFP_PER_MM] + 0; /* adding 0 turns -0 into 0 */
  const double x = real_min(true_x, 1e100);
  const double kept = real_min(real_max(x, c[FIRST_X]), c[LAST_X]);
  const double ln_x = real_log(kept, 0);
  double begin = c[BEGINS], first = c[FIRST_PANEL], per_panel = c[PER_PANEL];
  for (int i = 1; i < SEGMENTS; i++) {
    const bool behind = ln_x >= c[BEGINS + i];
    begin = behind ? c[BEGINS + i] : begin;
    first = behind ? c[FIRST_PANEL + i] : first;
    per_panel = behind ? c[PER_PANEL + i] : per_panel;
  }
  const double y = real_fma(ln_x - begin, per_panel, first);
  const double panel = real_max(real_min((double)(int64_t)y, c[PANELS] - 1), 0);
  const double s = real_max(real_min(2 * (y - panel) - 1, 1), -1);
  const struct series sum = sum_series(&c[SERIES + (size_t)panel * TERMS], s);
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
  return c[LIMIT] > 0 ? (p.x > 0 ? bounded : (double)INFINITY) : -(double)INFINITY;
}

static inline double transport_cdf(const double *c, double r) {
  const double cdf = energy_cdf(&c[SERIES + (size_t)c[PANELS] * TERMS], r);
  return c[LIMIT] > 0 ? cdf : 0;
}

CORE_KERNEL(eval_R, transport_R)
CORE_KERNEL(eval_cdf, transport_cdf)
CORE_KERNEL(eval_slope, transport_slope)
CORE_KERNEL(eval_ln_R, transport_ln_R)

CORE_KERNEL_TABLE(transport, CORE_KERNELS_OF_ALL);

#else
CORE_KERNEL_TABLE_NONE(transport);
#endif

#else /* what follows prepares a profile, and is compiled once for all instruction sets */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define CORE_REAL 64
#include "core/energy.h"
#include "core/gauss.h"
#include "core/kernel.h"
#include "core/model_error.h"
#include "core/transport/decay.h"
#include "core/transport/table.h"
#include "core/transport/transport.h"

#define TOLERANCE 1e-5
#define TOLERANCE_LEAST 1e-8
#define FIRST 1e-10
#define LAST 1e4
#define LAST_EXPONENT 30.0
#define PANEL_WIDTH 0.75 /* largest width of a panel in ln x */
#define LEAST_WIDTH 1e-3 /* least width of a segment in ln x */
/* cost of one value in kernel evaluations of a dipole, measured with `build/bench kernel` */
#define COST 8

/* Up to this sigma_a / sigma_s' an albedo is inverted if g is not 0, as the table ends there. */
#define RATIO_MOST 100.0

/* Next to eta = 1 the table is less exact far from the source in media that absorb: there R changes
 * by half a percent between eta = 1 and 1.0001, and the table's nodes do not follow. It is off by
 * up to 1.5e-5 at the end of the reach. */
#define TABLE_NEAR_1 1.6e-5
#define TABLE_IS_NEAR_1 1e-4

/* The error of dR/dr from the table of solutions is up to 20 times that of R (`make truth`). */
#define TABLE_SLOPE 32.0

/* For g other than 0 dR/dr jumps where panels of the table meet: at x = 1 it is off by up to 5e-3 (24
 * media against core/solver/). */
#define TABLE_SLOPE_JUMPS 1e-2

/* For a smaller single-scattering albedo the medium is solved with this one, and the result is
 * scaled: light that is scattered once is then in proportion to the albedo, and what is scattered
 * twice in proportion to its square. What is scattered more often does not matter. */
#define ALBEDO_LEAST 1e-12
/* For a smaller one, light that was scattered once is most of R near the source, and light that was
 * scattered twice is most of R far away, since it need not go at an angle under which it can leave.
 * ln R bends where the two meet: it takes narrower panels, and they are checked between their
 * nodes. */
#define ALBEDO_BENDS 0.01
#define PANEL_WIDTH_BENDS 0.15

core_check_function core_transport_check;
core_prepare_function core_transport_prepare;

core_fault core_transport_check(const core_inputs *inputs, core_radii_range *radii) {
  (void)radii;
  const double eta = inputs->medium->eta;
  if (!(eta >= TRANSPORT_ETA_MIN && eta <= TRANSPORT_ETA_MAX)) {
    return (core_fault){"eta", "0.25 to 4 with transport", 0};
  }
  if (core_parameter_or(inputs, CORE_PARAMETER_TOLERANCE, TOLERANCE) < TOLERANCE_LEAST) {
    return (core_fault){"tolerance", "1e-8 to 1 with transport", 0};
  }
  return (core_fault){0};
}

static core_fault solve(const core_inputs *inputs, double albedo, double tolerance,
                        transport_solution **solution) {
  transport_boundary *boundary;
  core_fault fault = transport_boundary_create(&boundary, inputs->medium->eta, tolerance);
  if (fault.field == NULL) {
    fault = transport_solve(solution, boundary, albedo);
  }
  transport_boundary_free(boundary);
  return fault;
}

/* The source of a profile, a solution or a table's series, and the positions of its panels. */
struct source {
  const transport_solution *solution;     /* NULL if `series` is the source */
  const transport_difference *difference; /* to be added to the solution, NULL if g is 0 */
  const transport_series *series;
  double kappa;          /* kappa of the medium */
  double solution_kappa; /* kappa of the solution's albedo */
  double extra_kappa; /* kappa of the solution if the solver was given a smaller albedo, else 0 */
  double share; /* albedo of the medium over that of the solution, if that is larger, else 1 */
  bool bends;   /* whether ln R may bend within a panel, and the error is measured */
  struct segment {
    double begin; /* in ln x */
    double width; /* of a panel */
    size_t panels;
  } segment[SEGMENTS]; /* those that are not used have no panels */
  size_t panels;
  double error;     /* largest relative error that the solver has estimated so far */
  double fit_error; /* the same of the series between its nodes, if it is measured */
  /* g is not 0: the panels are to be joined, as the table is not smooth at its edges */
  bool joined;
};

/* Returns the albedo that the solver is called with. The solver's bounds need some decay, so for an
 * albedo of 1 it solves 1 - 2^-53, where kappa = 1.8e-8. logarithm_at() divides out the factor (1 +
 * kappa x) e^(-kappa x) by which the two profiles differ. */
static double solvable_albedo(double albedo) {
  return fmin(fmax(albedo, ALBEDO_LEAST), 1 - 0x1p-53);
}

/* Returns by how much the solution for that albedo is to be multiplied. */
static double share_of(double albedo) {
  return albedo < ALBEDO_LEAST ? albedo / ALBEDO_LEAST : 1;
}

/* Returns L = ln(x R) + kappa x at y = ln x, from the source. */
static double logarithm_at(struct source *source, double y) {
  if (source->series != NULL) {
    return transport_series_at(source->series, y);
  }
  const double x = real_exp_signed(y);
  const transport_values at = transport_at(source->solution, x);
  const double extra = source->extra_kappa * x;
  const double R =
      source->share < 1 ? fma(source->share, at.multiple.value, at.single.value) : at.R.value;
  source->error = fmax(source->error, at.R.error / fmax(R, 1e-300));
  const double more =
      source->difference != NULL ? transport_difference_at(source->difference, y) : 0;
  return real_log(fmax(x * R, 1e-300), 0) + source->solution_kappa * x +
         (extra - real_log(1 + extra, 0)) + more;
}

/* Returns a panel's series at s from -1 to 1. */
static double series_at(const double *series, double s) {
  double sum = 0, p = 1, before = 0;
  for (int k = 0; k < TERMS; k++) {
    sum = fma(series[k], p, sum);
    const double next = ((2 * k + 1) * s * p - k * before) / (k + 1);
    before = p;
    p = next;
  }
  return sum;
}

/* Adds the error of a panel's series to the source's: twice the largest that is seen at its ends,
 * where such errors are largest, and in its middle. */
static void measure_panel(struct source *source, double y, double width, const double *series) {
  for (int i = 0; i <= 2; i++) {
    const double off = series_at(series, i - 1) - logarithm_at(source, fma(0.5 * i, width, y));
    source->fit_error = fmax(source->fit_error, 2 * fabs(off));
  }
}

/* Sets `series` to the Legendre series through the Gauss points of the panel that begins at ln x =
 * y. */
static void fit_panel(struct source *source, double y, double width, double *series) {
  memset(series, 0, TERMS * sizeof *series);
  for (int i = 0; i < 2 * CORE_GAUSS_HALF; i++) {
    const double s = 2 * core_gauss_node(i) - 1;
    const double value = logarithm_at(source, fma(width, core_gauss_node(i), y));
    double p = 1, before = 0;
    for (int k = 0; k < TERMS; k++) {
      series[k] += (2 * k + 1) * core_gauss_weight(i) * value * p;
      const double next = ((2 * k + 1) * s * p - k * before) / (k + 1);
      before = p;
      p = next;
    }
  }
}

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

/* Returns the last segment that has panels. */
static const struct segment *last_segment(const struct source *source) {
  int i = SEGMENTS - 1;
  while (source->segment[i].panels == 0) {
    i--;
  }
  return &source->segment[i];
}

static double last_of(const struct source *source) {
  const struct segment *segment = last_segment(source);
  return real_exp_signed(fma((double)segment->panels, segment->width, segment->begin));
}

static void set_series(struct source *source, double *c) {
  const double last = last_of(source);
  c[KAPPA] = source->kappa;
  c[PANELS] = (double)source->panels;
  c[FIRST_X] = real_exp_signed(source->segment[0].begin);
  c[LAST_X] = last;
  size_t panel = 0;
  for (int k = 0; k < SEGMENTS; k++) {
    const struct segment *segment = &source->segment[k];
    c[BEGINS + k] = segment->panels > 0 ? segment->begin : (double)INFINITY;
    c[FIRST_PANEL + k] = (double)panel;
    c[PER_PANEL + k] = segment->panels > 0 ? 1 / segment->width : 0;
    for (size_t i = 0; i < segment->panels; i++, panel++) {
      const double y = fma((double)i, segment->width, segment->begin);
      fit_panel(source, y, segment->width, &c[SERIES + panel * TERMS]);
      if (source->bends) {
        measure_panel(source, y, segment->width, &c[SERIES + panel * TERMS]);
      }
    }
  }
  if (source->joined) {
    transport_join_panels(source->panels, TERMS, &c[SERIES]);
  }
  const double more = steeper(&c[SERIES + (source->panels - 1) * TERMS],
                              last_segment(source)->width, source->kappa * last);
  const bool fades = last > 0.5 * LAST;
  c[STEEPER] = fades ? 0 : more;
  c[FADING] = fades ? more : 0;
}

/* Divides the range from ln_first to ln_last into panels. edges: those of the table of solutions, in
 * ascending order, where segments begin, or NULL. */
static void lay_panels(struct source *source, double ln_first, double ln_last,
                       const double edges[TRANSPORT_TABLE_PANELS + 1]) {
  const double most = source->bends ? PANEL_WIDTH_BENDS : PANEL_WIDTH;
  double begin = ln_first;
  int used = 0;
  for (int i = edges != NULL ? 1 : TRANSPORT_TABLE_PANELS + 1; i <= TRANSPORT_TABLE_PANELS + 1;
       i++) {
    const double end = i <= TRANSPORT_TABLE_PANELS ? edges[i] : ln_last;
    if (end > begin + LEAST_WIDTH && (end < ln_last - LEAST_WIDTH || end == ln_last)) {
      const double panels = ceil((end - begin) / most);
      source->segment[used++] = (struct segment){begin, (end - begin) / panels, (size_t)panels};
      source->panels += (size_t)panels;
      begin = end;
    }
  }
}

/* Makes the table of a profile that scatters, `share` times the source, and adds it to the
 * preparation, whose albedo has been set. */
static core_fault fill(const core_inputs *inputs, struct source *source, double share,
                       core_preparation *preparation) {
  if (inputs->only_albedo) {
    return (core_fault){0};
  }
  const double sigma_t_prime = core_sigma_t_prime(inputs->medium);
  const double mfp_mm = 1 / sigma_t_prime;
  const double first = real_exp_signed(source->segment[0].begin);
  /* Less than 1e-12 of the energy lies beyond 40 decay lengths 1 / kappa, or beyond 1e12 mean free
   * paths. */
  const double energy_last =
      source->kappa * 1e12 > 40 ? fmax(40 / source->kappa, last_of(source)) : 1e12;
  const size_t before_energy = SERIES + source->panels * TERMS;
  const size_t energy_length = core_energy_length(first * mfp_mm, energy_last * mfp_mm);
  preparation->table_bytes = (before_energy + energy_length) * sizeof(double);
  double *c = malloc(preparation->table_bytes);
  if (c == NULL) {
    return CORE_OUT_OF_MEMORY;
  }
  set_scales(c, sigma_t_prime, share);
  set_series(source, c);
  core_kernel_f64 *R =
      core_isa_kernels(inputs->isa, CORE_MODEL_TRANSPORT)->f64->evaluate[CORE_ELEMENTWISE_R];
  const double energy =
      core_energy_build(R, c, first * mfp_mm, energy_last * mfp_mm, &c[before_energy]);
  if (source->joined) {
    /* The albedo has a table of its own, which is more exact than that of R. */
    set_scales(c, sigma_t_prime, share * (preparation->albedo / energy));
  }
  preparation->table = c;
  return (core_fault){0};
}

static core_fault fill_nothing(double sigma_t_prime, core_preparation *preparation) {
  preparation->table_bytes =
      (SERIES + TERMS + CORE_ENERGY_SERIES + CORE_ENERGY_TERMS) * sizeof(double);
  double *c = calloc(1, preparation->table_bytes);
  if (c == NULL) {
    return CORE_OUT_OF_MEMORY;
  }
  set_scales(c, sigma_t_prime, 0);
  c[PANELS] = 1;
  c[FIRST_X] = FIRST;
  c[LAST_X] = LAST;
  double *energy = &c[SERIES + TERMS];
  energy[CORE_ENERGY_PANELS] = 1;
  energy[CORE_ENERGY_FIRST_MM] = 1;
  energy[CORE_ENERGY_PER_PANEL] = 1;
  preparation->table = c;
  return (core_fault){0};
}

/* Where less than this share is absorbed, 1 less the albedo is in proportion to the root of it. An
 * albedo of scattering next to 1 has too few digits to say how much is absorbed. */
#define ABSORBED_FEW 0x1p-20

/* Returns the albedo of a medium, for which a solution at a clamped and rounded albedo of scattering
 * has `total`. All light leaves a medium that absorbs none. */
static double albedo_of_total(const core_medium *medium, double solvable, double total) {
  const double absorbed = medium->sigma_a_per_mm / core_sigma_t_prime(medium);
  return absorbed < ABSORBED_FEW ? 1 - (1 - total) * sqrt(absorbed / (1 - solvable)) : total;
}

/* The same where the total is looked up, with an absolute error of 1e-8. */
static double albedo_looked_up(const core_medium *medium, double total) {
  return medium->sigma_a_per_mm > 0 ? fmin(total, 1) : 1;
}

/* Solves the medium with isotropic scattering. difference: what the medium's g adds to the
 * solution, or NULL if there is none. */
static core_fault solve_and_fill(const core_inputs *inputs, double albedo, double asked,
                                 const transport_difference *difference,
                                 core_preparation *preparation) {
  const core_medium *medium = inputs->medium;
  const double tolerance = fmin(0.5 * asked, TRANSPORT_TOLERANCE_MAX);
  const double solvable = solvable_albedo(albedo);
  const double share = share_of(albedo);
  if (inputs->only_albedo) {
    transport_number total = {.value = 0};
    const core_fault fault =
        difference != NULL ? (core_fault){0} : transport_solve_total(&total, medium->eta, solvable);
    preparation->albedo = difference != NULL
                              ? albedo_looked_up(medium, difference->total)
                              : albedo_of_total(medium, solvable, total.value) * share;
    return fault;
  }
  transport_solution *solution = NULL;
  core_fault fault = solve(inputs, solvable, tolerance, &solution);
  if (fault.field == NULL) {
    /* If the absorption is too small to make the albedo differ from 1, kappa is computed from the
     * absorption itself. */
    const bool shows = albedo <= solvable;
    const double absorbed = medium->sigma_a_per_mm / core_sigma_t_prime(medium);
    const double kappa = shows ? transport_kappa(solvable) : sqrt(3 * absorbed);
    const double reach = kappa * LAST > LAST_EXPONENT ? LAST_EXPONENT / kappa : LAST;
    struct source source = {.solution = solution,
                            .difference = difference,
                            .joined = difference != NULL,
                            .kappa = difference != NULL && shows ? difference->kappa : kappa,
                            .solution_kappa = kappa,
                            .extra_kappa = shows ? 0 : transport_kappa(solvable),
                            .share = share,
                            .bends = difference == NULL && albedo < ALBEDO_BENDS};
    lay_panels(&source, real_log(FIRST, 0), real_log(reach, 0),
               difference != NULL ? difference->edge : NULL);
    preparation->albedo =
        difference != NULL
            ? albedo_looked_up(medium, difference->total)
            : albedo_of_total(medium, solvable, transport_total(solution).value) * share;
    fault = fill(inputs, &source, share, preparation);
    preparation->error = fmax(asked, source.error + source.fit_error);
  }
  transport_solution_free(solution);
  return fault;
}

static double albedo_of(const core_medium *medium) {
  return medium->sigma_s_per_mm * (1 - medium->g) / core_sigma_t_prime(medium);
}

/* Returns the table of solutions if it covers the anisotropic scattering of this medium, else NULL.
 */
static const transport_table *table_for_g(const core_medium *medium) {
  const bool isotropic = !(medium->g < 0 || medium->g > 0);
  const transport_table *table = isotropic ? NULL : transport_table_shipped();
  const bool serves = table != NULL && transport_table_covers_difference(table, albedo_of(medium),
                                                                         medium->g, medium->eta);
  return serves ? table : NULL;
}

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

/* The reach that the profile reports is that of the table of solutions, which is shorter than the
 * solver's: so it does not depend on which of the two was used. For g other than 0 it ends about where
 * R falls below TRANSPORT_TABLE_R_LEAST, or at FARTHEST, so that the profile's last band of radii, from
 * 10 mean free paths on, does not state the error of still larger radii. The growth is an upper bound
 * of what was measured against the solver up to 30 decay lengths, where R is above 1e-17. */
core_reach core_transport_reach(const core_medium *medium) {
  const double sigma_t_prime = core_sigma_t_prime(medium);
  const double albedo = albedo_of(medium), kappa = transport_kappa(albedo);
  if (table_for_g(medium) != NULL) {
    return (core_reach){
        .most_mm = radius_of_R_least(albedo, medium->eta, kappa) / sigma_t_prime,
        .growth = 0.015 + 4 * kappa * kappa,
    };
  }
  return (core_reach){.most_mm = 1 / (kappa / LAST_EXPONENT + 1 / LAST) / sigma_t_prime,
                      .growth = fmin(0.5, kappa + 1e-4)};
}

double core_transport_ratio_most(double g, double eta) {
  const core_medium medium = {RATIO_MOST, 1 / (1 - g), g, eta};
  return table_for_g(&medium) != NULL ? RATIO_MOST : (double)INFINITY;
}

bool core_transport_added_errors(const core_medium *medium, core_added_errors *added) {
  *added = (core_added_errors){{0}, 0};
  const transport_table *table = table_for_g(medium);
  if (table == NULL) {
    return !(medium->g < 0 || medium->g > 0) || !(medium->sigma_s_per_mm > 0);
  }
  const double albedo = albedo_of(medium), g = medium->g;
  const size_t bands = CORE_MODEL_ERROR_BANDS;
  /* Beyond the reach core_error_beyond() is added. */
  const double reach = core_transport_reach(medium).most_mm * core_sigma_t_prime(medium);
  for (size_t i = 0; i < bands; i++) {
    const double least = i == 0 ? 0 : core_error_edges_mfp[i];
    const double most =
        i + 1 == bands ? fmax(least, reach) : core_error_edges_mfp[i + 1] * (1 - 1e-6);
    added->banded[i] = transport_table_error(table, albedo, g, medium->eta, least, most);
    added->all = fmax(added->all, added->banded[i]);
  }
  added->banded[bands] = transport_table_total_error(table, g);
  /* The cdf and the pdf have the error of R and that of the energy that they are divided by. */
  added->all = 2 * fmax(added->all, added->banded[bands]);
  return true;
}

static double isotropic_error(const transport_table *table) {
  return transport_table_error(table, 0.5, 0, 1, 0, INFINITY) + TOLERANCE_LEAST;
}

static double error_of_R(const transport_table *table, double eta) {
  return isotropic_error(table) + (fabs(eta - 1) < TABLE_IS_NEAR_1 ? TABLE_NEAR_1 : 0);
}

double core_transport_table_error(double eta) {
  const transport_table *table = transport_table_shipped();
  return table != NULL ? error_of_R(table, eta) : (double)INFINITY;
}

/* This is more than the error of R. */
static double error_of_slope(const transport_table *table) {
  return isotropic_error(table) * TABLE_SLOPE;
}

double core_transport_slope_error(void) {
  const transport_table *table = transport_table_shipped();
  return table != NULL ? error_of_slope(table) : 0;
}

static core_fault look_up(const core_inputs *inputs, double albedo, double g,
                          const transport_table *table, core_preparation *preparation) {
  transport_series series;
  transport_table_look_up(table, albedo, g, inputs->medium->eta, &series);
  struct source source = {.series = &series, .kappa = series.kappa, .joined = g < 0 || g > 0};
  lay_panels(&source, series.edge[0], series.edge[TRANSPORT_TABLE_PANELS],
             source.joined ? series.difference.edge : NULL);
  preparation->albedo = series.total;
  const bool as_R = source.joined || inputs->tabulated > 0;
  preparation->error = as_R ? error_of_R(table, inputs->medium->eta) : error_of_slope(table);
  preparation->slope_error = source.joined ? TABLE_SLOPE_JUMPS : error_of_slope(table);
  return fill(inputs, &source, 1, preparation);
}

/* Prepares a medium whose scattering the table covers. */
static core_fault prepare_anisotropic(const core_inputs *inputs, double albedo, double asked,
                                      const transport_table *table, core_preparation *preparation) {
  const core_medium *medium = inputs->medium;
  transport_difference difference;
  if (transport_table_covers(table, albedo, medium->g, medium->eta)) {
    return look_up(inputs, albedo, medium->g, table, preparation);
  }
  transport_table_difference(table, albedo, medium->g, medium->eta, &difference);
  return solve_and_fill(inputs, albedo, asked, &difference, preparation);
}

/* Returns the table of solutions if it covers this medium with isotropic scattering and is as
 * accurate as inputs->tabulated or a tolerance that was given asks, else NULL. */
static const transport_table *table_for(const core_inputs *inputs, double albedo) {
  const double given = core_parameter_or(inputs, CORE_PARAMETER_TOLERANCE, 0);
  const transport_table *table = transport_table_shipped();
  const bool serves = table != NULL &&
                      transport_table_covers(table, albedo, 0, inputs->medium->eta) &&
                      (error_of_R(table, inputs->medium->eta) <= inputs->tabulated ||
                       error_of_slope(table) <= given);
  return serves ? table : NULL;
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

static core_fault prepare(const core_inputs *inputs, core_preparation *preparation) {
  const double albedo = albedo_of(inputs->medium);
  const double asked = core_parameter_or(inputs, CORE_PARAMETER_TOLERANCE, TOLERANCE);
  preparation->notes = core_transport_added_errors(inputs->medium, &preparation->added)
                           ? 0
                           : (unsigned)CORE_NOTE_SIMILARITY;
  preparation->error = asked;
  preparation->cost = COST;
  if (!(albedo > 0)) {
    return fill_nothing(core_sigma_t_prime(inputs->medium), preparation);
  }
  preparation->reach = core_transport_reach(inputs->medium);
  const transport_table *for_g = table_for_g(inputs->medium);
  const transport_table *table = table_for(inputs, albedo);
  return for_g != NULL   ? prepare_anisotropic(inputs, albedo, asked, for_g, preparation)
         : table != NULL ? look_up(inputs, albedo, 0, table, preparation)
                         : solve_and_fill(inputs, albedo, asked, NULL, preparation);
}

bool core_transport_is_stored(const core_medium *medium) {
  const double albedo = albedo_of(medium), g = table_for_g(medium) != NULL ? medium->g : 0;
  const transport_table *table = transport_table_shipped();
  return !(albedo > 0) || (table != NULL && transport_table_covers(table, albedo, g, medium->eta));
}

unsigned core_transport_way(const core_inputs *inputs) {
  enum { NOTHING, SOLVED, LOOKED_UP, DIFFERENCE, LOOKED_UP_G, SIMILAR = 8 };
  const core_medium medium =
      core_transport_medium(inputs->medium, inputs->parameters->value[CORE_PARAMETER_GAMMA]);
  const double albedo = albedo_of(&medium);
  const transport_table *for_g = table_for_g(&medium);
  const bool anisotropic = medium.g < 0 || medium.g > 0;
  return !(albedo > 0)   ? NOTHING
         : for_g == NULL ? (table_for(inputs, albedo) != NULL ? LOOKED_UP : SOLVED) +
                               (anisotropic ? SIMILAR : 0)
         : transport_table_covers(for_g, albedo, medium.g, medium.eta) ? LOOKED_UP_G
                                                                       : DIFFERENCE;
}

core_fault core_transport_prepare(const core_inputs *inputs, core_preparation *preparation) {
  const core_medium medium =
      core_transport_medium(inputs->medium, inputs->parameters->value[CORE_PARAMETER_GAMMA]);
  core_inputs taken = *inputs;
  taken.medium = &medium;
  return prepare(&taken, preparation);
}

#endif
