#include "core/fit/loops.h"

#define CORE_REAL 64
#include "core/kernel.h"

enum {
  RATIOS = FIT_TABLE_RATIOS,
  PLACES = FIT_TABLE_PLACES,
  ACROSS = 6, /* number of points for interpolation in ln_ratio */
  ALONG = 4,  /* number of points for interpolation in ln x or ln q */
  BLOCK = 64, /* number of places that are looked up together */
};

/* ---- the table ------------------------------------------------------------------------------- */

/* The stencil of a number among equally spaced nodes: index of the first node to use, Lagrange
 * polynomials and their derivatives by the step. */
struct stencil {
  size_t first;
  double value[ACROSS];
  double slope[ACROSS];
};

static struct stencil stencil_across(double position) {
  static const double per_factorial[ACROSS] = {-1.0 / 120, 1.0 / 24,  -1.0 / 12,
                                               1.0 / 12,   -1.0 / 24, 1.0 / 120};
  struct stencil stencil;
  const double first = real_min(real_max(position - (ACROSS / 2 - 1), 0), RATIOS - ACROSS);
  stencil.first = (size_t)first;
  const double t = position - (double)stencil.first;
  for (int j = 0; j < ACROSS; j++) {
    double product = per_factorial[j], slope = 0;
    for (int k = 0; k < ACROSS; k++) {
      slope = k == j ? slope : slope * (t - k) + product;
      product = k == j ? product : product * (t - k);
    }
    stencil.value[j] = product;
    stencil.slope[j] = slope;
  }
  return stencil;
}

/* Numbers of a medium that all readings share. */
struct medium {
  double sigma_t_prime;
  double ln_sigma_t_prime;
  double absorbed; /* sigma_a / sigma_t', which is d ln sigma_t' / d ln_ratio */
  double kappa;
  double kappa_slope; /* by ln_ratio */
  double scale;       /* sigma_t' sigma_s' */
  struct stencil across;
};

static struct medium medium_at(const fit_table *table, double ln_ratio, double ln_scattering) {
  const double ratio = real_exp_signed(ln_ratio), scattering = real_exp_signed(ln_scattering);
  struct medium m = {.sigma_t_prime = scattering * (1 + ratio),
                     .ln_sigma_t_prime = ln_scattering + real_log(1 + ratio, 0),
                     .absorbed = ratio / (1 + ratio)};
  m.scale = m.sigma_t_prime * scattering;
  m.across = stencil_across((ln_ratio - table->ratio_least) / table->ratio_step);
  for (size_t i = 0; i < ACROSS; i++) {
    m.kappa += m.across.value[i] * table->kappa[m.across.first + i];
    m.kappa_slope += m.across.slope[i] * table->kappa[m.across.first + i];
  }
  m.kappa_slope /= table->ratio_step;
  return m;
}

/* Stencils of BLOCK places. value: L and its derivative by ln_ratio at the nodes of each stencil,
 * already interpolated in ln_ratio. */
struct places {
  int32_t first[BLOCK];
  double inside[BLOCK]; /* 1, or 0 where L is constant because the place is outside the table */
  double value[ALONG][BLOCK];
  double slope[ALONG][BLOCK];
  double L[BLOCK][ALONG];
  double by_ratio[BLOCK][ALONG];
};

/* first: the table's first logarithm minus the medium's shift of the logarithms. */
static void find_places(const fit_table *table, double first, size_t n, const double *ln_at,
                        struct places *places) {
  const double per_step = 1 / table->ln_step;
  for (size_t i = 0; i < n; i++) {
    const double unlimited = (ln_at[i] + first) * per_step;
    const double position = real_min(real_max(unlimited, 0), PLACES - 1);
    const int32_t begin =
        (int32_t)real_min(real_max(position - (ALONG / 2 - 1), 0), PLACES - ALONG);
    const double a = position - begin, b = a - 1, c = a - 2, d = a - 3, ab = a * b, cd = c * d;
    places->first[i] = begin;
    places->inside[i] = unlimited == position ? 1 : 0;
    places->value[0][i] = -1.0 / 6 * (b * cd);
    places->value[1][i] = 0.5 * (a * cd);
    places->value[2][i] = -0.5 * (ab * d);
    places->value[3][i] = 1.0 / 6 * (ab * c);
    places->slope[0][i] = -1.0 / 6 * (cd + b * (c + d));
    places->slope[1][i] = 0.5 * (cd + a * (c + d));
    places->slope[2][i] = -0.5 * (ab + (a + b) * d);
    places->slope[3][i] = 1.0 / 6 * (ab + (a + b) * c);
  }
}

typedef double along __attribute__((vector_size(ALONG * sizeof(double)), aligned(8)));

static void interpolate_across(const fit_table *table, const struct stencil *across, size_t n,
                               struct places *places) {
  for (size_t i = 0; i < n; i++) {
    const double *row = &table->L[across->first * PLACES + (size_t)places->first[i]];
    along L = {0}, by_ratio = {0};
    for (size_t k = 0; k < ACROSS; k++, row += PLACES) {
      L += across->value[k] * *(const along *)(const void *)row;
      by_ratio += across->slope[k] * *(const along *)(const void *)row;
    }
    *(along *)(void *)places->L[i] = L;
    *(along *)(void *)places->by_ratio[i] = by_ratio;
  }
}

/* L and its derivatives by ln_ratio and by ln x, per step of the table. */
struct interpolated {
  double value[BLOCK];
  double by_ratio[BLOCK];
  double by_ln[BLOCK];
};

static void interpolate_along(const struct places *places, size_t n, struct interpolated *found) {
  for (size_t i = 0; i < n; i++) {
    double value = 0, by_ratio = 0, by_ln = 0;
    for (size_t k = 0; k < ALONG; k++) {
      value += places->value[k][i] * places->L[i][k];
      by_ratio += places->value[k][i] * places->by_ratio[i][k];
      by_ln += places->slope[k][i] * places->L[i][k];
    }
    found->value[i] = value;
    found->by_ratio[i] = by_ratio;
    found->by_ln[i] = places->inside[i] * by_ln;
  }
}

static inline double kept_exp(double x) {
  return real_exp_signed(real_min(real_max(x, -690), 690));
}

static void give_transfer(const fit_table *table, const struct medium *m, size_t n,
                          const struct interpolated *L, double *value, double *by_ratio,
                          double *by_scattering) {
  const double per_step = 1 / table->ln_step, per_ratio = 1 / table->ratio_step;
  for (size_t i = 0; i < n; i++) {
    const double by_ln = L->by_ln[i] * per_step, R = kept_exp(L->value[i]);
    value[i] = R;
    by_scattering[i] = -R * by_ln;
    by_ratio[i] = R * (L->by_ratio[i] * per_ratio - by_ln * m->absorbed);
  }
}

/* ln R = L - ln x - kappa x + ln(1 + kappa x) + ln(sigma_t'^2 sigma_s' / sigma_t') */
static void give_R(const fit_table *table, const struct medium *m, size_t n, const double *at,
                   const struct interpolated *L, double *value, double *by_ratio,
                   double *by_scattering) {
  const double per_step = 1 / table->ln_step, per_ratio = 1 / table->ratio_step;
  for (size_t i = 0; i < n; i++) {
    const double x = at[i] * m->sigma_t_prime, kx = m->kappa * x;
    const double bent = kx / (1 + kx); /* derivative of ln(1 + kappa x) by ln x */
    const double R = m->scale * (1 + kx) * kept_exp(L->value[i] - kx) / x;
    const double by_x = L->by_ln[i] * per_step - 1 - kx + bent;
    value[i] = R;
    by_scattering[i] = R * (by_x + 2);
    by_ratio[i] =
        R * (L->by_ratio[i] * per_ratio - m->kappa_slope * x * bent + m->absorbed * (by_x + 1));
  }
}

static void look_up(const fit_table *table, double ln_ratio, double ln_scattering, size_t n,
                    const double *at, const double *ln_at, double *value, double *by_ratio,
                    double *by_scattering) {
  const struct medium m = medium_at(table, ln_ratio, ln_scattering);
  const double first =
      (table->waves ? FIT_LN_2_PI - m.ln_sigma_t_prime : m.ln_sigma_t_prime) - table->ln_least;
  for (size_t i = 0; i < n; i += BLOCK) {
    const size_t some = n - i < BLOCK ? n - i : BLOCK;
    struct places places;
    struct interpolated L;
    find_places(table, first, some, ln_at + i, &places);
    interpolate_across(table, &m.across, some, &places);
    interpolate_along(&places, some, &L);
    if (table->waves) {
      give_transfer(table, &m, some, &L, value + i, by_ratio + i, by_scattering + i);
    } else {
      give_R(table, &m, some, at + i, &L, value + i, by_ratio + i, by_scattering + i);
    }
  }
}

/* ---- readings -------------------------------------------------------------------------------- */

static void logarithms(size_t n, const double *restrict x, double *restrict out) {
  for (size_t i = 0; i < n; i++) {
    out[i] = real_log(real_max(x[i], 0x1p-1022), 0);
  }
}

#if defined __AVX512F__
enum { LANES = 8 };
#elif defined __AVX__
enum { LANES = 4 };
#else
enum { LANES = 2 };
#endif
enum { GROUPS = FIT_LOOPS_MEDIA / LANES };
typedef double lanes __attribute__((vector_size(LANES * sizeof(double)), aligned(8)));

static double measure(size_t media, const double *model, size_t count, const double *value,
                      const double *weight, bool free_offset, double *chi) {
  double weights = 0, least = (double)INFINITY;
  for (size_t k = 0; k < count; k++) {
    weights += weight[k];
  }
  const double per_weight = free_offset && weights > 0 ? 1 / weights : 0;
  for (size_t i = 0; i < media; i += FIT_LOOPS_MEDIA) {
    lanes sum[GROUPS] = {0}, square[GROUPS] = {0};
    for (size_t k = 0; k < count; k++) {
      const lanes *row = (const lanes *)(const void *)(model + k * media + i);
#pragma GCC unroll 8
      for (size_t group = 0; group < GROUPS; group++) {
        const lanes off = value[k] - row[group], weighted = weight[k] * off;
        sum[group] += weighted;
        square[group] += weighted * off;
      }
    }
    lanes *here = (lanes *)(void *)(chi + i);
#pragma GCC unroll 8
    for (size_t group = 0; group < GROUPS; group++) {
      here[group] = square[group] - per_weight * (sum[group] * sum[group]);
    }
    for (size_t k = i; k < i + FIT_LOOPS_MEDIA; k++) {
      least = chi[k] < least ? chi[k] : least;
    }
  }
  return least;
}

extern const fit_loops CORE_PASTE2(fit_loops_, CORE_ISA);
const fit_loops CORE_PASTE2(fit_loops_, CORE_ISA) = {look_up, logarithms, measure};
