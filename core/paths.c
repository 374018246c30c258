#include "core/paths.h"

#include <assert.h>
#include <float.h>
#include <math.h>

#include "core/kernels.h"
#include "core/transport/functions.h"

/* ---- path lengths ---------------------------------------------------------------------------- */

/* Returns a quantity over -d ln R / d ln sigma_a; DPF has to be divided by r besides. */
static double per_derivative(const core_profile *profile, enum core_quantity quantity) {
  const double mm = 1 / profile->path_sigma_a_per_mm;
  return quantity == CORE_QUANTITY_TIME ? mm * profile->path_index / CORE_LIGHT_SPEED_MM_PER_PS
                                        : mm;
}

void core_paths_make(const core_profile *profile, enum core_quantity quantity, size_t n,
                     const double *r, double *values) {
  const double factor = per_derivative(profile, quantity);
  for (size_t i = 0; i < n; i++) {
    const double value = factor * (0 - values[i]);
    const bool is_dpf = quantity == CORE_QUANTITY_DPF;
    values[i] = !is_dpf ? value : r[i] > 0 ? value / r[i] : (double)INFINITY;
  }
}

/* ---- modulated light ------------------------------------------------------------------------- */

enum { NODES = CORE_MODULATION_NODES_MAX, NODES_FEW = 7, CHUNK = 64 };

/* Returns the middle of the nodes' span. */
static double middle_of(const core_nodes *of) {
  return 0.5 * (of->u[0] + of->u[of->count - 1]);
}

/* Sets cosine[j] to Chebyshev's polynomial of a degree at node j of n, cos(degree (j + 1/2) pi / n). */
static void find_cosines(unsigned n, double cosine[NODES], unsigned degree) {
  for (unsigned j = 0; j < n; j++) {
    double sine;
    fn_sincos(degree * (j + 0.5) * FN_PI / n, &sine, &cosine[j]);
  }
}

double complex core_modulated_u(double sigma_a_per_mm, double wavenumber_per_mm) {
  return fn_csqrt(CMPLX(sigma_a_per_mm, wavenumber_per_mm));
}

core_nodes core_nodes_around(bool few, double least, double complex u) {
  core_nodes made = {.count = few ? NODES_FEW : NODES};
  const double wide = fmin(fmax(0.5 * creal(u), (few ? 2.5 : 2) * cimag(u)), creal(u));
  const double low = fmax(creal(u) - wide, least), half = 0.5 * (creal(u) + wide - low);
  double cosine[NODES];
  find_cosines(made.count, cosine, 1);
  for (unsigned j = 0; j < made.count; j++) {
    made.u[j] = low + half + half * cosine[j];
  }
  return made;
}

/* Sets share[j] to that of value j in the coefficient of a term of the Chebyshev series. Returns its
 * polynomial at u. */
static double complex find_term(const core_nodes *of, unsigned degree, double complex u,
                                double share[NODES]) {
  double first[NODES];
  find_cosines(of->count, first, 1);
  find_cosines(of->count, share, degree);
  const double complex z = (u - middle_of(of)) * (first[0] / (of->u[0] - middle_of(of)));
  double complex before = 1, at = z;
  for (unsigned k = 1; k < degree; k++) {
    const double complex next = 2 * z * at - before;
    before = at;
    at = next;
  }
  for (unsigned j = 0; j < of->count; j++) {
    share[j] *= 2.0 / of->count;
  }
  return at;
}

core_continuation core_continue_to(const core_nodes *of, double complex u) {
  core_continuation to = {.u = u};
  for (unsigned j = 0; j < of->count; j++) {
    to.weight[j] = 1;
    for (unsigned k = 0; k < of->count; k++) {
      to.weight[j] *= k == j ? 1 : (u - of->u[k]) * (1 / (of->u[j] - of->u[k]));
    }
  }
  for (unsigned k = 0; k < 2 && of->count > 0; k++) {
    to.polynomial[k] = find_term(of, of->count - 1 - k, u, to.share[k]);
  }
  return to;
}

/* R e^(-b u) over that at the middle node is about 1 at all nodes. */
void core_continue(const core_nodes *of, const core_continuation to[2], const double *ln_R,
                   size_t stride, core_continued at[2]) {
  const unsigned last = of->count - 1, middle = of->count / 2;
  const double b = (ln_R[0] - ln_R[last * stride]) / (of->u[0] - of->u[last]);
  double value[NODES];
  for (unsigned j = 0; j <= last; j++) {
    const double moved = ln_R[j * stride] - ln_R[middle * stride] - b * (of->u[j] - of->u[middle]);
    value[j] = fn_exp(fmin(moved, 700));
  }
  for (int k = 0; k < 2; k++) {
    double complex sum = 0;
    for (unsigned j = 0; j <= last; j++) {
      sum += to[k].weight[j] * value[j];
    }
    at[k].is_known = fn_norm2(sum) > DBL_MIN && (cimag(to[k].u) != 0 || creal(sum) > DBL_MIN);
    const double complex moved = b * (to[k].u - of->u[middle]);
    at[k].ln_R = at[k].is_known ? ln_R[middle * stride] + moved + fn_clog(sum) : 0;
    const double complex over = at[k].is_known ? fn_inverse(sum) : 0;
    for (unsigned j = 0; j <= last; j++) {
      at[k].relative[j] = value[j] * over;
    }
  }
}

/* -arg R in degrees, or |R| over that without modulation; 0 where it is not known. */
static double value_of(const core_continued at[2], bool is_phase) {
  return !(at[0].is_known && at[1].is_known) ? 0
         : is_phase                          ? -(180 / FN_PI) * cimag(at[0].ln_R)
                                             : fn_exp(fmin(creal(at[0].ln_R - at[1].ln_R), 700));
}

/* What a profile's modulated light is continued to: `there`, and `here`. */
struct both {
  core_continuation to[2];
};

static struct both both_of(const core_modulation *of) {
  return (struct both){
      {core_continue_to(&of->nodes, of->there), core_continue_to(&of->nodes, of->here)}};
}

static bool is_of_waves(enum core_quantity quantity) {
  return (quantity & CORE_MODULATED_F) != 0;
}

static bool is_phase_of(enum core_quantity quantity) {
  return (quantity & (CORE_QUANTITY_PHASE | CORE_QUANTITY_PHASE_F)) != 0;
}

/* Sets ln_R[j * CHUNK + i] to that of node j at r[i], or at the frequency r[i] if `waves`; n is at most
 * CHUNK. */
static void look_at(const core_modulation *of, bool waves, size_t n, const double *r,
                    double *ln_R) {
  for (unsigned j = 0; j < of->nodes.count; j++) {
    double *to = ln_R + j * CHUNK;
    core_evaluate(&of->node[j], waves ? CORE_QUANTITY_TRANSFER : CORE_QUANTITY_LN_R, n, r, to);
    for (size_t i = 0; i < n && waves; i++) {
      to[i] = to[i] > 0 ? fn_log(to[i]) : -(double)INFINITY;
    }
  }
}

static bool is_finite(const core_modulation *of, const double *ln_R) {
  return isfinite(ln_R[0]) && isfinite(ln_R[(of->nodes.count - 1) * CHUNK]);
}

void core_modulation_eval(const core_profile *profile, enum core_quantity quantity, size_t n,
                          const double *r, double *out) {
  const core_modulation *of = profile->modulation;
  assert(of != NULL);
  const bool is_phase = is_phase_of(quantity);
  const unsigned nodes = of->nodes.count;
  const struct both to = both_of(of);
  double ln_R[NODES * CHUNK];
  for (size_t done = 0; done < n; done += CHUNK) {
    const size_t count = n - done < CHUNK ? n - done : CHUNK;
    look_at(of, is_of_waves(quantity), count, r + done, ln_R);
    for (size_t i = 0; i < count; i++) {
      /* Where R is infinite the paths have no length; where it is 0 there is no light. */
      double value = is_phase || (nodes > 0 && ln_R[i] < 0) ? 0 : 1;
      if (nodes > 0 && is_finite(of, ln_R + i)) {
        core_continued at[2];
        core_continue(&of->nodes, to.to, ln_R + i, CHUNK, at);
        value = value_of(at, is_phase);
      }
      out[done + i] = value;
    }
  }
}

/* ---- errors ---------------------------------------------------------------------------------- */

/* The error of an interpolation is found at radii of one lattice, this far apart in ln r, so that more
 * radii never state less; by how much they go beyond those of the request, because the last terms of the
 * series are 0 at some radii; and what is stated over what is found. */
#define STEP 0.03
#define AROUND 1.3
#define MARGIN 3
/* Radii are at least this many mean free paths, and frequencies this share of the light's decay per mm,
 * as nearer to 0 nothing changes. */
#define NEAREST 1e-3
#define FARTHEST 1e103 /* over the nearest */
/* An interpolation with a larger relative error is not trusted to know it. */
#define UNKNOWN 0.05
/* The derivatives of paths where sigma_a is low: the sum of the sizes of their terms that do not grow
 * with r, over sigma_a / sigma_t', and the mean free paths up to which those that grow are evaluated;
 * from 1e100 on R is 0. */
#define FAINT_TERMS 16
#define FAINT_REACH 1e90
/* What rounding adds for each weight. */
#define ROUNDING 1e-14

/* What the series leaves out is judged by its last two coefficients, each in either of the last two
 * terms: one coefficient may be 0 by chance, and one polynomial nearly the same at both u. */
double core_continued_error(const core_nodes *nodes, bool is_angle,
                            const core_continuation *const u[2], const core_continued at[2],
                            const double *error) {
  double complex of[2] = {0, 0}, less[2] = {0, 0}; /* the coefficients, for u[0] and u[1] */
  /* the difference of two logarithms is rounded by as much as they are */
  double sum = DBL_EPSILON * (fn_abs(at[0].ln_R) + (u[1] != NULL ? fn_abs(at[1].ln_R) : 0));
  double cut = 0;
  for (unsigned j = 0; j < nodes->count; j++) {
    const double complex by_one = u[0]->weight[j] * at[0].relative[j];
    double complex by = by_one;
    by -= u[1] != NULL ? u[1]->weight[j] * at[1].relative[j] : 0;
    sum += error[j] * fabs(is_angle ? cimag(by) : creal(by)) + ROUNDING * fn_abs(by_one);
    for (int k = 0; k < 2; k++) {
      of[k] += u[0]->share[k][j] * at[0].relative[j];
      less[k] += u[1] != NULL ? u[1]->share[k][j] * at[1].relative[j] : 0;
    }
  }
  double slow = 0;
  for (int k = 0; k < 2; k++) {
    double most = 0;
    for (int l = 0; l < 2; l++) {
      const double complex other = u[1] != NULL ? less[k] * u[1]->polynomial[l] : 0;
      most = fmax(most, fn_abs(of[k] * u[0]->polynomial[l] - other));
    }
    cut += k == 0 ? most : 0.25 * most;
    slow = fmax(slow, fn_abs(of[k] * u[0]->polynomial[k]));
  }
  const bool known = at[0].is_known && (u[1] == NULL || at[1].is_known) && slow < UNKNOWN;
  return known ? sum + MARGIN * cut : (double)INFINITY;
}

/* Sets the errors of ln R at the nodes; of R(f) over the albedo if `waves`. */
static void find_node_errors(const core_modulation *of, bool waves, core_radii_range radii,
                             double error[NODES]) {
  for (unsigned j = 0; j < of->nodes.count; j++) {
    const core_stated_errors stated = core_profile_errors(
        &of->node[j], waves ? CORE_QUANTITY_TRANSFER : CORE_QUANTITY_LN_R, radii);
    error[j] = stated.numerical + (waves ? 0 : stated.numerical_per_mm * radii.most_mm);
  }
}

/* Returns the error at a radius or frequency of this ln R, of which `error` is as found above. */
static double modulated_error_at(const core_profile *profile, enum core_quantity quantity,
                                 const struct both *to, const double *ln_R, const double *error) {
  const core_modulation *of = profile->modulation;
  const core_continuation *const u[2] = {&to->to[0], &to->to[1]};
  const bool waves = is_of_waves(quantity), is_phase = is_phase_of(quantity);
  double of_ln_R[NODES];
  for (unsigned j = 0; j < of->nodes.count; j++) {
    of_ln_R[j] =
        1e-12 + error[j] * (waves ? of->node[j].albedo * fn_exp(fmin(-ln_R[j * CHUNK], 700)) : 1);
  }
  core_continued at[2];
  core_continue(&of->nodes, to->to, ln_R, CHUNK, at);
  const double value = value_of(at, is_phase);
  const double off = core_continued_error(&of->nodes, is_phase, u, at, of_ln_R);
  const double rounded = profile->evaluator == CORE_EVALUATOR_F64 ? 0 : (double)FLT_EPSILON;
  return (is_phase || isinf(off) ? off * (180 / FN_PI) : off * value) + rounded * fabs(value);
}

static double modulated_error(const core_profile *profile, enum core_quantity quantity,
                              core_radii_range radii) {
  const bool waves = is_of_waves(quantity);
  const core_modulation *of = profile->modulation;
  if (of == NULL || of->nodes.count == 0 || radii.least_mm > radii.most_mm) {
    return 0;
  }
  const struct both to = both_of(of);
  double error[NODES], ln_R[NODES * CHUNK], r[CHUNK];
  find_node_errors(of, waves, radii, error);
  const double sigma_t_prime = core_sigma_t_prime(&profile->medium);
  const double near =
      NEAREST * (waves ? fn_abs(of->there) * sqrt(sigma_t_prime) : 1 / sigma_t_prime);
  const double nearest = fmin(fmax(radii.least_mm / near, 1), FARTHEST);
  const double farthest = fmin(fmax(radii.most_mm / near, 1), FARTHEST);
  const double least = floor(fn_log(nearest / AROUND) / STEP);
  const double most = ceil(fn_log(farthest * AROUND) / STEP);
  double largest = 0;
  for (double first = least; first <= most && largest < (double)INFINITY; first += CHUNK) {
    const size_t count = (size_t)fmin(most - first + 1, CHUNK);
    for (size_t i = 0; i < count; i++) {
      r[i] = near * fn_exp(STEP * (first + (double)i));
    }
    look_at(of, waves, count, r, ln_R);
    for (size_t i = 0; i < count; i++) {
      if (is_finite(of, ln_R + i)) {
        largest = fmax(largest, modulated_error_at(profile, quantity, &to, ln_R + i, error));
      } else if (waves) {
        return (double)INFINITY; /* R(f) is lost in its errors */
      }
    }
  }
  return largest;
}

/* Returns what multiplies the errors of a derivative that is in proportion to sigma_a: the sum of the
 * sizes of its terms, most of which grow with r, at most as a 1.5 (r sigma_t')^2. */
static double faint_share(const core_profile *of, double most_mm) {
  const double sigma_t_prime = core_sigma_t_prime(&of->medium);
  const double a = of->path_sigma_a_per_mm / sigma_t_prime;
  double value = 2e200 * a;
  if (most_mm * sigma_t_prime < FAINT_REACH) {
    core_evaluate(of, CORE_QUANTITY_BY_SIGMA_A, 1, &most_mm, &value);
  }
  return FAINT_TERMS * a + 2 * fabs(value);
}

core_stated_errors core_paths_errors(const core_profile *profile, enum core_quantity quantity,
                                     core_stated_errors derivative, core_radii_range radii) {
  if ((quantity & CORE_MODULATED) != 0) {
    return (core_stated_errors){.numerical = modulated_error(profile, quantity, radii)};
  }
  const bool any = radii.least_mm <= radii.most_mm;
  const core_profile *of = profile->paths != NULL ? profile->paths : profile;
  const double share = of == profile ? 1 : any ? faint_share(of, radii.most_mm) : 0;
  const double factor = share * per_derivative(of, quantity);
  return quantity == CORE_QUANTITY_DPF
             ? (core_stated_errors){.numerical =
                                        any ? factor * (derivative.numerical / radii.least_mm +
                                                        derivative.numerical_per_mm)
                                            : 0}
             : (core_stated_errors){derivative.numerical * factor,
                                    derivative.numerical_per_mm * factor};
}
