/* The derivatives of ln R by ln sigma_a and ln sigma_s of models whose kernels do not have them:
 * differences of ln R of neighbours, the same model with sigma_a times e^(j STEP).
 *
 * A joint factor on sigma_a and sigma_s is the same as one on r and one on R: R(r; f sigma) = f^2
 * R(f r; sigma). So the derivative by ln sigma_s is 2 + d ln R / d ln r less that by ln sigma_a. A
 * slab, whose thickness is a length too, has neighbours in sigma_s instead.
 *
 * The formulas are those of Fornberg 1988, "Generation of finite difference formulas on arbitrarily
 * spaced grids", Tables 1 and 3, of order 6: exact up to STEP^6 / 140 times the seventh derivative
 * in the middle, and STEP^6 / 7 at an end.
 */
#include <assert.h>
#include <math.h>
#include <string.h>

#include "core/kernels.h"

#define CORE_REAL 64
#include "core/kernel.h"

enum { CHUNK = 64 };

/* For smaller radii R is in proportion to this one's, as far as it changes with the medium. */
#define NEAREST_MM 1e-280

static const double weights[][CORE_NEIGHBOURS] = {
    {-147.0 / 60, 6, -7.5, 20.0 / 3, -3.75, 1.2, -1.0 / 6},
    {-1.0 / 60, 0.15, -0.75, 0, 0.75, -0.15, 1.0 / 60},
    {1.0 / 6, -1.2, 3.75, -20.0 / 3, 7.5, -6, 147.0 / 60},
};

double core_neighbour_factor(int position) {
  return real_exp_signed(position * CORE_NEIGHBOUR_STEP);
}

/* Returns the weights for the position of the first neighbour: 0, -3 or -6. */
static const double *weights_from(int first) {
  return weights[-first / 3];
}

double core_slab_truncation(const core_medium *medium, double thickness_mm, bool in_s, int first) {
  const double changed = in_s ? medium->sigma_s_per_mm * (1 - medium->g) : medium->sigma_a_per_mm;
  const double rest = core_sigma_t_prime(medium) - changed;
  const double behind = fma(thickness_mm, rest + changed, -1);
  double sum = 0;
  for (int j = 0; j < CORE_NEIGHBOURS; j++) {
    const double other = rest + changed * core_neighbour_factor(first + j);
    const double ln = real_log(fma(thickness_mm, other, -1), 0);
    sum = fma(weights_from(first)[j] / CORE_NEIGHBOUR_STEP, ln, sum);
  }
  return fabs(sum - thickness_mm * changed / behind);
}

/* Adds what ln_R is more than the first neighbour's, times weight / STEP. The weights add up to 0,
 * so that the first one's need not be added. */
static void add(size_t n, double weight, const double *ln_R, const double *of_first, double *sum) {
  for (size_t i = 0; i < n; i++) {
    sum[i] = fma(weight / CORE_NEIGHBOUR_STEP, ln_R[i] - of_first[i], sum[i]);
  }
}

/* Sets sum[n] to the derivative along the neighbours of one coefficient. */
static void along(const core_profile *neighbours, int first, size_t n, const double *r,
                  double *sum) {
  double of_first[CHUNK], ln_R[CHUNK];
  memset(sum, 0, n * sizeof *sum);
  core_run_kernel(neighbours, CORE_ELEMENTWISE_LN_R, n, r, of_first);
  for (int j = 1; j < CORE_NEIGHBOURS; j++) {
    core_run_kernel(&neighbours[j], CORE_ELEMENTWISE_LN_R, n, r, ln_R);
    add(n, weights_from(first)[j], ln_R, of_first, sum);
  }
}

/* Sets sum[n] to the derivative by a joint factor on both coefficients. */
static void along_both(const core_profile *middle, size_t n, const double *r, double *sum) {
  double radii[CHUNK], of_first[CHUNK], ln_R[CHUNK];
  for (size_t i = 0; i < n; i++) {
    sum[i] = 2;
  }
  for (int j = 0; j < CORE_NEIGHBOURS; j++) {
    const double factor = core_neighbour_factor(j - CORE_NEIGHBOURS / 2);
    for (size_t i = 0; i < n; i++) {
      radii[i] = r[i] * factor;
    }
    core_run_kernel(middle, CORE_ELEMENTWISE_LN_R, n, radii, j == 0 ? of_first : ln_R);
    add(n, weights_from(-CORE_NEIGHBOURS / 2)[j], j == 0 ? of_first : ln_R, of_first, sum);
  }
}

static void differentiate(const core_profile *profile, enum core_quantity quantity, size_t n,
                          const double *r, double *out) {
  const core_profile *near = profile->near;
  assert(near != NULL);
  const int *first = profile->near_first;
  double by_a[CHUNK];
  if (quantity == CORE_QUANTITY_BY_SIGMA_A) {
    along(near, first[0], n, r, out);
  } else if (profile->near_count > CORE_NEIGHBOURS) {
    along(near + CORE_NEIGHBOURS, first[1], n, r, out);
  } else {
    along_both(&near[-first[0]], n, r, out);
    along(near, first[0], n, r, by_a);
    for (size_t i = 0; i < n; i++) {
      out[i] -= by_a[i];
    }
  }
}

void core_derivative(const core_profile *profile, enum core_quantity quantity, size_t n,
                     const double *r, double *out) {
  if ((profile->notes & CORE_NOTE_MEDIUM_UNUSED) != 0) {
    memset(out, 0, n * sizeof *out);
    return;
  }
  for (size_t done = 0; done < n; done += CHUNK) {
    const size_t count = n - done < CHUNK ? n - done : CHUNK;
    double kept[CHUNK];
    for (size_t i = 0; i < count; i++) {
      kept[i] = real_max(r[done + i], NEAREST_MM);
    }
    differentiate(profile, quantity, count, kept, out + done);
    for (size_t i = done; i < done + count; i++) {
      /* where ln R is not finite R is 0 and does not change */
      out[i] = fabs(out[i]) < (double)INFINITY ? out[i] : 0;
    }
  }
}
