#include "core/model_error.h"

#include <math.h>
#include <stddef.h>

enum { RATIOS = 16, ETAS = 4, G_RATIOS = 5 };

static const double ratios[RATIOS] = {1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 0.01, 0.02,
                                      0.05, 0.1,  0.2,  0.5,  1,    2,    5,    10};
static const double etas[ETAS] = {1, 1.3, 1.5, 2};
static const double g_ratios[G_RATIOS] = {1e-4, 1e-2, 0.1, 1, 10};

struct isotropic {
  unsigned model;
  double worst[RATIOS][ETAS];
};

struct anisotropic {
  double g;
  double worst[G_RATIOS];
};

#define ISOTROPIC(model, ...) {model, {__VA_ARGS__}},
#define ANISOTROPIC(g, ...)
static const struct isotropic isotropic[] = {
#include "core/model_errors.def"
};
#undef ISOTROPIC
#undef ANISOTROPIC

#define ISOTROPIC(model, ...)
#define ANISOTROPIC(g, ...) {g, {__VA_ARGS__}},
static const struct anisotropic anisotropic[] = {
#include "core/model_errors.def"
};

enum {
  ISOTROPICS = sizeof isotropic / sizeof isotropic[0],
  ANISOTROPICS = sizeof anisotropic / sizeof anisotropic[0],
};

/* The neighbours of a value in a rising list: first and last, the same where they meet; false
 * outside of the list. A ratio that was rounded on its way is not outside. */
struct span {
  size_t first;
  size_t last;
};

static bool enclose(const double *list, size_t count, double value, struct span *span) {
  const double slack = 1e-9;
  if (!(value >= list[0] * (1 - slack) && value <= list[count - 1] * (1 + slack))) {
    return false;
  }
  span->first = 0;
  while (span->first + 1 < count && list[span->first + 1] * (1 - slack) <= value) {
    span->first++;
  }
  const bool met = fabs(list[span->first] - value) <= slack * value || span->first + 1 == count;
  span->last = met ? span->first : span->first + 1;
  return true;
}

static double isotropic_error(const struct isotropic *of, struct span ratio, struct span eta) {
  double worst = 0;
  for (size_t i = ratio.first; i <= ratio.last; i++) {
    for (size_t j = eta.first; j <= eta.last; j++) {
      worst = fmax(worst, of->worst[i][j]);
    }
  }
  return worst;
}

/* The nodes around g, of which 0, where there is no error, is one. NAN: not measured. */
static double similarity_error(double g, struct span ratio) {
  double nodes[ANISOTROPICS];
  for (size_t k = 0; k < ANISOTROPICS; k++) {
    nodes[k] = anisotropic[k].g;
  }
  if (!(g >= nodes[0] && g <= nodes[ANISOTROPICS - 1])) {
    return (double)NAN;
  }
  size_t above = 0;
  while (nodes[above] < g) {
    above++;
  }
  const size_t below = nodes[above] > g && above > 0 ? above - 1 : above;
  double worst = 0;
  for (size_t k = below; k <= above; k++) {
    /* a node on the other side of 0 says nothing here */
    for (size_t i = ratio.first; i <= ratio.last && (nodes[k] > 0) == (g > 0); i++) {
      const double error = anisotropic[k].worst[i];
      worst = isnan(error) || isnan(worst) ? (double)NAN : fmax(worst, error);
    }
  }
  return worst;
}

double core_model_error(enum core_model model, const core_medium *medium, bool similarity) {
  const double g = medium->g;
  const double ratio = medium->sigma_a_per_mm / (medium->sigma_s_per_mm * (1 - g));
  const bool is_isotropic = !(g < 0 || g > 0);
  struct span at_ratio, at_eta, at_g_ratio;
  if (model == CORE_MODEL_TRANSPORT && is_isotropic) {
    return 0;
  }
  if (!enclose(ratios, RATIOS, ratio, &at_ratio) || !enclose(etas, ETAS, medium->eta, &at_eta) ||
      !enclose(g_ratios, G_RATIOS, ratio, &at_g_ratio)) {
    return (double)NAN;
  }
  if (!is_isotropic && !similarity) {
    return (
        double)NAN; /* single scattering alone, whose anisotropy is exact and was not measured */
  }
  if (model == CORE_MODEL_TRANSPORT) {
    return similarity_error(g, at_g_ratio);
  }
  for (size_t i = 0; i < ISOTROPICS; i++) {
    if (isotropic[i].model == (unsigned)model) {
      const double error = isotropic_error(&isotropic[i], at_ratio, at_eta);
      const double more = is_isotropic ? 0 : similarity_error(g, at_g_ratio);
      return (1 + error) * (1 + more) - 1;
    }
  }
  return (double)NAN;
}
