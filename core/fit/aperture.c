/* FORMAT of aperture.table: for each side of eta = 1, below first, each term of v, of g and of ln u, and
 * each term of s: the number of terms of y in a byte, and each of them as a packed integer
 * (core/chebyshev.h), the coefficient over FIT_APERTURE_QUANTUM. */
#include "core/fit/aperture.h"

#include <assert.h>
#include <stdbool.h>
#include <stdint.h>

#include "core/chebyshev.h"
#include "core/transport/decay.h"
#include "core/transport/functions.h"

#define CORE_REAL 64
#include "core/kernel.h"

__asm__(".pushsection .rodata\n"
        ".globl fit_aperture_data\n"
        ".hidden fit_aperture_data\n"
        ".type fit_aperture_data, %object\n"
        "fit_aperture_data:\n"
        ".incbin \"core/fit/aperture.table\"\n"
        ".size fit_aperture_data, . - fit_aperture_data\n"
        ".popsection\n");
#pragma GCC visibility push(hidden)
extern const uint8_t fit_aperture_data[];
#pragma GCC visibility pop

enum {
  PLACES = FIT_APERTURE_PLACES,
  RATIOS = FIT_APERTURE_RATIOS,
  ETAS = FIT_APERTURE_ETAS_BELOW + FIT_APERTURE_ETAS_FROM,
  GS = FIT_APERTURE_GS,
  CONES = FIT_APERTURE_CONES,
};

/* ---- coordinates ----------------------------------------------------------------------------- */

static double ln(double x) {
  return real_log(x, 0);
}

/* Maps x from [least, most] to [-1, 1], and limits it to that. */
static double mapped(double x, double least, double most) {
  return real_min(real_max((2 * x - least - most) / (most - least), -1), 1);
}

/* Returns Chebyshev node i of `count` in [least, most]; node 0 is `least`. */
static double node(size_t i, size_t count, double least, double most) {
  double sine, cosine;
  fn_sincos(FN_PI * (double)i / (double)(count - 1), &sine, &cosine);
  return i + 1 == count ? most : least + 0.5 * (1 - cosine) * (most - least);
}

static double s_of(double ratio) {
  return sqrt(ratio / (1 + ratio));
}

static double v_of(double eta) {
  const double least = eta < 1 ? eta : 1 / eta;
  return sqrt((1 - least) * (1 + least));
}

static double ln_reach(double ratio) {
  return -ln(transport_kappa(1 / (1 + ratio)) / 20 + 0.01);
}

static const double ratio_least = 1e-6;

double fit_aperture_ratio(size_t i) {
  const double s = node(i, RATIOS, s_of(ratio_least), s_of(FIT_APERTURE_RATIO_MOST));
  return s * s / ((1 - s) * (1 + s));
}

double fit_aperture_eta(size_t i) {
  const bool below = i < FIT_APERTURE_ETAS_BELOW;
  const double v = below ? node(FIT_APERTURE_ETAS_BELOW - 1 - i, FIT_APERTURE_ETAS_BELOW, 0,
                                v_of(FIT_APERTURE_ETA_LEAST))
                         : node(i - FIT_APERTURE_ETAS_BELOW, FIT_APERTURE_ETAS_FROM, 0,
                                v_of(FIT_APERTURE_ETA_MOST));
  const double least = sqrt((1 - v) * (1 + v));
  return below ? least : 1 / least;
}

double fit_aperture_g(size_t i) {
  return node(i, GS, 0, FIT_APERTURE_G_MOST);
}

double fit_aperture_u(size_t i) {
  return real_exp_signed(node(i, CONES, ln(FIT_APERTURE_U_LEAST), 0));
}

double fit_aperture_x(size_t i, double ratio) {
  return real_exp_signed(node(i, PLACES, ln(FIT_APERTURE_X_LEAST), ln_reach(ratio)));
}

/* ---- the series ------------------------------------------------------------------------------ */

void fit_aperture_prepare(fit_aperture *aperture, double g, double eta, double NA) {
  assert(g >= 0 && g <= FIT_APERTURE_G_MOST && NA > 0 && NA <= 1);
  assert(eta >= FIT_APERTURE_ETA_LEAST && eta <= FIT_APERTURE_ETA_MOST);
  const double u = real_min(NA / real_min(eta, 1), 1);
  const double v_most = v_of(eta < 1 ? FIT_APERTURE_ETA_LEAST : FIT_APERTURE_ETA_MOST);
  double by_eta[ETAS] = {0}, by_g[GS], by_u[CONES];
  if (eta < 1) {
    core_chebyshev_polynomials(FIT_APERTURE_ETAS_BELOW, mapped(v_of(eta), 0, v_most), by_eta);
  } else {
    core_chebyshev_polynomials(FIT_APERTURE_ETAS_FROM, mapped(v_of(eta), 0, v_most),
                               by_eta + FIT_APERTURE_ETAS_BELOW);
  }
  core_chebyshev_polynomials(GS, mapped(g, 0, FIT_APERTURE_G_MOST), by_g);
  core_chebyshev_polynomials(CONES, mapped(ln(u), ln(FIT_APERTURE_U_LEAST), 0), by_u);
  *aperture = (fit_aperture){.u2 = u * u};
  const uint8_t *next = fit_aperture_data;
  for (size_t row = 0; row < (size_t)ETAS * GS * CONES * RATIOS; row++) {
    const size_t s = row % RATIOS, cone = row / RATIOS % CONES, k = row / RATIOS / CONES % GS;
    const double factor =
        FIT_APERTURE_QUANTUM * by_eta[row / RATIOS / CONES / GS] * by_g[k] * by_u[cone];
    const size_t terms = *next++;
    for (size_t i = 0; i < terms; i++) {
      aperture->term[s][i] += factor * (double)core_packed_integer(&next);
    }
  }
}

void fit_aperture_medium(const fit_aperture *aperture, double ratio, fit_aperture_row *row) {
  double by_s[RATIOS];
  const double least = s_of(ratio_least), most = s_of(FIT_APERTURE_RATIO_MOST);
  const double kept = real_min(real_max(ratio, ratio_least), FIT_APERTURE_RATIO_MOST);
  core_chebyshev_polynomials(RATIOS, mapped(s_of(kept), least, most), by_s);
  *row = (fit_aperture_row){.u2 = aperture->u2, .ln_reach = ln_reach(kept)};
  for (size_t s = 0; s < RATIOS; s++) {
    for (size_t i = 0; i < PLACES; i++) {
      row->term[i] += by_s[s] * aperture->term[s][i];
    }
  }
}

double fit_aperture_share(const fit_aperture_row *row, double ln_x) {
  const double p = mapped(ln_x, ln(FIT_APERTURE_X_LEAST), row->ln_reach);
  return row->u2 * real_exp_signed(core_chebyshev_sum(PLACES, row->term, p));
}

/* ---- errors ---------------------------------------------------------------------------------- */

/* A region of media, distances and apertures, and the largest error found in it. */
static const struct region {
  double ratio_from, ratio_to, x_from, x_to, u_from, u_to;
  double error;
} regions[] = {
#define FIT_APERTURE_ERROR(...) {__VA_ARGS__},
#include "core/fit/aperture_errors.def"
};

/* Relative tolerance for values at the end of a range, which callers may have rounded. */
#define SLACK 1e-7

double fit_aperture_error(const fit_aperture *aperture, double ratio, double x_least,
                          double x_most) {
  const double u = sqrt(aperture->u2);
  double error = -1;
  if (!(x_least >= FIT_APERTURE_X_LEAST * (1 - SLACK) &&
        x_most <= real_exp_signed(ln_reach(ratio)) * (1 + SLACK))) {
    return (double)NAN;
  }
  for (size_t i = 0; i < sizeof regions / sizeof regions[0]; i++) {
    const struct region *at = &regions[i];
    if (ratio >= at->ratio_from && ratio <= at->ratio_to * (1 + SLACK) && x_most >= at->x_from &&
        x_least <= at->x_to && u >= at->u_from * (1 - SLACK) && u <= at->u_to) {
      error = real_max(error, at->error);
    }
  }
  return error < 0 ? (double)NAN : error;
}
