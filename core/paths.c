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

enum { NODES = CORE_MODULATION_NODES_MAX, CHUNK = 64 };

/* Returns the middle of the nodes' span. */
static double middle_of(const core_modulation *of) {
  return 0.5 * (of->u[0] + of->u[of->count - 1]);
}

/* Sets cosine[j] to Chebyshev's polynomial of a degree at node j of n, cos(degree (j + 1/2) pi / n). */
static void find_cosines(unsigned n, double cosine[NODES], unsigned degree) {
  for (unsigned j = 0; j < n; j++) {
    double sine;
    fn_sincos(degree * (j + 0.5) * FN_PI / n, &sine, &cosine[j]);
  }
}

enum { NODES_FEW = 7 };

void core_modulation_place(core_modulation *to, bool few, double sigma_a_per_mm,
                           double wavenumber_per_mm) {
  assert(wavenumber_per_mm > 0);
  to->here = sqrt(sigma_a_per_mm);
  to->there = fn_csqrt(CMPLX(sigma_a_per_mm, wavenumber_per_mm));
  to->count = few ? NODES_FEW : NODES;
  const double middle = creal(to->there);
  const double half = fmin(fmax(0.5 * middle, (few ? 2.5 : 2) * cimag(to->there)), middle);
  double cosine[NODES];
  find_cosines(to->count, cosine, 1);
  for (unsigned j = 0; j < to->count; j++) {
    to->u[j] = middle + half * cosine[j];
  }
}

/* Sets weight[j] to those of the polynomial through values at the nodes, at u. */
static void find_weights(const core_modulation *of, double complex u,
                         double complex weight[NODES]) {
  for (unsigned j = 0; j < of->count; j++) {
    weight[j] = 1;
    for (unsigned k = 0; k < of->count; k++) {
      weight[j] *= k == j ? 1 : (u - of->u[k]) * (1 / (of->u[j] - of->u[k]));
    }
  }
}

/* Sets weight[j] to the share of value j in a term of the Chebyshev series at u. */
static void find_term(const core_modulation *of, unsigned degree, double complex u,
                      double complex weight[NODES]) {
  double cosine[NODES], first[NODES];
  find_cosines(of->count, first, 1);
  find_cosines(of->count, cosine, degree);
  const double complex z = (u - middle_of(of)) * (first[0] / (of->u[0] - middle_of(of)));
  double complex before = 1, at = z;
  for (unsigned k = 1; k < degree; k++) {
    const double complex next = 2 * z * at - before;
    before = at;
    at = next;
  }
  for (unsigned j = 0; j < of->count; j++) {
    weight[j] = at * (2 * cosine[j] / of->count);
  }
}

/* The weights of one profile. */
struct weights {
  double complex here[NODES], there[NODES];
};

static struct weights weights_of(const core_modulation *of) {
  struct weights made;
  find_weights(of, of->here, made.here);
  find_weights(of, of->there, made.there);
  return made;
}

/* R e^(-b u) at the nodes over that at the middle one, which are all about 1, and what becomes of
 * them. */
struct continued {
  double b;
  double value[NODES];
  double complex there;
  double here;
};

static double complex sum_of(const core_modulation *of, const double complex weight[NODES],
                             const double value[NODES]) {
  double complex sum = 0;
  for (unsigned j = 0; j < of->count; j++) {
    sum += weight[j] * value[j];
  }
  return sum;
}

/* ln_R[j * CHUNK]: ln R at node j. */
static struct continued continue_R(const core_modulation *of, const struct weights *weights,
                                   const double *ln_R) {
  const unsigned last = of->count - 1, middle = of->count / 2;
  struct continued to;
  to.b = (ln_R[0] - ln_R[last * CHUNK]) / (of->u[0] - of->u[last]);
  for (unsigned j = 0; j <= last; j++) {
    const double moved = ln_R[j * CHUNK] - ln_R[middle * CHUNK] - to.b * (of->u[j] - of->u[middle]);
    to.value[j] = fn_exp(fmin(moved, 700));
  }
  to.there = sum_of(of, weights->there, to.value);
  to.here = creal(sum_of(of, weights->here, to.value));
  return to;
}

static bool is_known(const struct continued *of) {
  return of->here > DBL_MIN && fn_norm2(of->there) > DBL_MIN;
}

/* Returns -arg R in degrees, or |R| over that without modulation. */
static double phase_of(const core_modulation *of, const struct continued *at) {
  return -(180 / FN_PI) * (at->b * cimag(of->there) + cimag(fn_clog(at->there)));
}

static double modulation_of(const core_modulation *of, const struct continued *at) {
  const double ln =
      at->b * (creal(of->there) - of->here) + creal(fn_clog(at->there)) - fn_log(at->here);
  return fn_exp(fmin(ln, 700));
}

/* Sets ln_R[j * CHUNK + i] to that of node j at r[i]; n is at most CHUNK. */
static void look_at(const core_modulation *of, size_t n, const double *r, double *ln_R) {
  for (unsigned j = 0; j < of->count; j++) {
    core_evaluate(&of->node[j], CORE_QUANTITY_LN_R, n, r, ln_R + j * CHUNK);
  }
}

void core_modulation_eval(const core_profile *profile, enum core_quantity quantity, size_t n,
                          const double *r, double *out) {
  const core_modulation *of = profile->modulation;
  assert(of != NULL);
  const bool is_phase = quantity == CORE_QUANTITY_PHASE;
  const struct weights weights = weights_of(of);
  double ln_R[NODES * CHUNK];
  for (size_t done = 0; done < n; done += CHUNK) {
    const size_t count = n - done < CHUNK ? n - done : CHUNK;
    look_at(of, count, r + done, ln_R);
    for (size_t i = 0; i < count; i++) {
      /* Where R is infinite the paths have no length; where it is 0 there is no light. */
      double value = is_phase || (of->count > 0 && ln_R[i] < 0) ? 0 : 1;
      if (of->count > 0 && isfinite(ln_R[i]) && isfinite(ln_R[(of->count - 1) * CHUNK + i])) {
        const struct continued at = continue_R(of, &weights, ln_R + i);
        value = !is_known(&at) ? 0 : is_phase ? phase_of(of, &at) : modulation_of(of, &at);
      }
      out[done + i] = value;
    }
  }
}

/* ---- errors ---------------------------------------------------------------------------------- */

/* The radii at which the error of an interpolation is found; by how much they go beyond those of the
 * request, because the last terms of the series are 0 at some radii; and what is stated over what is
 * found. */
enum { PLACES = 33 };
#define AROUND 1.3
#define MARGIN 3
#define NEAREST_MFP 1e-3
/* An interpolation with a larger relative error is not trusted to know it. */
#define UNKNOWN 0.05

/* Returns by how much a change of ln R by `there` and `here` changes a quantity. */
static double change(bool is_phase, double complex there, double here) {
  return is_phase ? fabs(cimag(there)) : fabs(creal(there) - here);
}

/* Returns the error of the angle -arg R, or of ln |R|, at one radius. error[j]: of ln R at node j. */
static double error_at(const core_modulation *of, const struct continued *at,
                       const struct weights *weights, const double complex term[4][NODES],
                       const double error[NODES], bool is_phase) {
  const double complex there = fn_inverse(at->there);
  const double here = 1 / at->here;
  double sum = 0;
  for (unsigned j = 0; j < of->count; j++) {
    sum += error[j] * at->value[j] *
           change(is_phase, weights->there[j] * there, creal(weights->here[j]) * here);
  }
  for (int k = 0; k < 2; k++) {
    const double complex off = sum_of(of, term[k], at->value) * there;
    const double off_here = creal(sum_of(of, term[2 + k], at->value)) * here;
    sum += (k == 0 ? MARGIN : 0.25 * MARGIN) * fn_abs(off - off_here);
    sum = fn_abs(off) < UNKNOWN ? sum : (double)INFINITY;
  }
  return sum;
}

static double modulated_error(const core_profile *profile, bool is_phase, core_radii_range radii) {
  const core_modulation *of = profile->modulation;
  if (of == NULL || of->count == 0 || radii.least_mm > radii.most_mm) {
    return 0;
  }
  const struct weights weights = weights_of(of);
  double complex term[4][NODES];
  double error[NODES], ln_R[NODES * CHUNK], r[PLACES];
  for (unsigned k = 0; k < 4; k++) {
    find_term(of, of->count - 1 - k % 2, k < 2 ? of->there : of->here, term[k]);
  }
  const double near = NEAREST_MFP / core_sigma_t_prime(&profile->medium);
  const double least = fmax(radii.least_mm, near) / AROUND, most_mm = fmax(radii.most_mm, near);
  const double step = fn_log(most_mm * AROUND / least) / (PLACES - 1);
  for (int i = 0; i < PLACES; i++) {
    r[i] = least * fn_exp(step * i);
  }
  look_at(of, PLACES, r, ln_R);
  for (unsigned j = 0; j < of->count; j++) {
    const core_stated_errors stated = core_profile_errors(&of->node[j], CORE_QUANTITY_LN_R, radii);
    error[j] = stated.numerical + stated.numerical_per_mm * radii.most_mm + 1e-12;
  }
  double most = 0;
  for (int i = 0; i < PLACES; i++) {
    if (isfinite(ln_R[i]) && isfinite(ln_R[(of->count - 1) * CHUNK + i])) {
      const struct continued at = continue_R(of, &weights, ln_R + i);
      const double value = !is_known(&at) ? 0
                           : is_phase     ? phase_of(of, &at)
                                          : modulation_of(of, &at);
      const double off =
          is_known(&at) ? error_at(of, &at, &weights, term, error, is_phase) : (double)INFINITY;
      const double rounded = profile->evaluator == CORE_EVALUATOR_F64 ? 0 : (double)FLT_EPSILON;
      most = fmax(most, (is_phase || isinf(off) ? off * (180 / FN_PI) : off * value) +
                            rounded * fabs(value));
    }
  }
  return most;
}

core_stated_errors core_paths_errors(const core_profile *profile, enum core_quantity quantity,
                                     core_stated_errors derivative, core_radii_range radii) {
  if ((quantity & (CORE_QUANTITY_PHASE | CORE_QUANTITY_MODULATION)) != 0) {
    return (core_stated_errors){
        .numerical = modulated_error(profile, quantity == CORE_QUANTITY_PHASE, radii)};
  }
  const double factor = per_derivative(profile, quantity);
  const bool any = radii.least_mm <= radii.most_mm;
  return quantity == CORE_QUANTITY_DPF
             ? (core_stated_errors){.numerical =
                                        any ? factor * (derivative.numerical / radii.least_mm +
                                                        derivative.numerical_per_mm)
                                            : 0}
             : (core_stated_errors){derivative.numerical * factor,
                                    derivative.numerical_per_mm * factor};
}
