/* The distance s of two random points of the discs has the density
 *
 *   p(s) = s int_0^2pi C(t) dphi,  t^2 = d^2 + s^2 - 2 d s cos phi
 *
 * where d is the distance of the centres and C(t) the area that the discs share when their centres
 * are t apart, divided by the product of their areas: C is the density of the difference of two
 * such points. The mean of R is int p(s) R(s) ds. In panels of ln s, s R(s) is replaced by the
 * polynomial through Gauss points, and the polynomial is integrated with p(s) as it is, kinks
 * included. So the weights know the discs, and the nodes R alone.
 */
#include "core/fit/discs.h"

#include <stdbool.h>

#include "core/gauss.h"
#include "core/transport/functions.h"

#define CORE_REAL 64
#include "core/kernel.h"

enum {
  POINTS = 2 * CORE_GAUSS_HALF,
  PER_PANEL = 8, /* nodes */
  PANELS_MOST = 6,
};
_Static_assert((int)PER_PANEL *PANELS_MOST <= (int)FIT_DISC_NODES, "the nodes have room");

#define PANEL_RATIO 3.5 /* ends of a panel */
#define NEAREST                                                                                    \
  0.0019 /* start of the first panel if the discs overlap, over the largest distance */

/* Two discs: their radii, the larger first, and the distance of their centres. */
struct discs {
  double large;
  double small;
  double apart;
};

/* Returns arccos x, with x limited to [-1, 1]. */
static double arccos(double x) {
  const double kept = real_min(real_max(x, -1), 1);
  return cimag(fn_clog(CMPLX(kept, sqrt((1 - kept) * (1 + kept)))));
}

/* Returns C(t). The area of a lens: Weisstein, "Circle-circle intersection". */
static double shared_area(const struct discs *discs, double t) {
  const double a = discs->large, b = discs->small;
  if (t >= a + b) {
    return 0;
  }
  if (t <= a - b) {
    return 1 / (FN_PI * a * a);
  }
  const double to_a = (t * t + a * a - b * b) / (2 * t), to_b = t - to_a;
  const double lens = a * a * arccos(to_a / a) + b * b * arccos(to_b / b) -
                      t * sqrt(real_max(a * a - to_a * to_a, 0));
  return lens / (FN_PI * FN_PI * a * a * b * b);
}

/* Returns the angle at which two points at distances d and s from a third are t apart. */
static double angle_at(double d, double s, double t) {
  return arccos((d * d + s * s - t * t) / (2 * d * s));
}

/* Returns 3 x^2 - 2 x^3, which maps [0, 1] to itself with zero slope at both ends, where integrands
 * may have roots. */
static double eased(double x) {
  return x * x * (3 - 2 * x);
}

static double ease_slope(double x) {
  return 6 * x * (1 - x);
}

/* Returns the integral of C over the angle phi in [from, to]. */
static double over_angles(const struct discs *discs, double s, double from, double to) {
  double sum = 0;
  for (int i = 0; i < POINTS && to > from; i++) {
    const double x = core_gauss_node(i), phi = from + (to - from) * eased(x);
    double sine, cosine;
    fn_sincos(0.5 * phi, &sine, &cosine);
    const double d = discs->apart, off = d - s;
    const double t = sqrt(off * off + 4 * d * s * sine * sine);
    sum += core_gauss_weight(i) * ease_slope(x) * shared_area(discs, t);
  }
  return sum * (to - from);
}

/* Returns p(s). */
static double density(const struct discs *discs, double s) {
  const double whole = discs->large - discs->small, none = discs->large + discs->small;
  if (!(discs->apart > 0)) {
    return 2 * FN_PI * s * shared_area(discs, s);
  }
  const double inner = angle_at(discs->apart, s, whole), outer = angle_at(discs->apart, s, none);
  const double covered =
      discs->small > 0 || s > 0 ? inner / (FN_PI * discs->large * discs->large) : 0;
  return 2 * s * (covered + over_angles(discs, s, inner, outer));
}

/* Sets edges to `from`, the kinks of p(s) between `from` and `to` in ascending order, and `to`.
 * Returns the number of edges. */
enum { KINKS = 5 };
static size_t find_kinks(const struct discs *discs, double from, double to,
                         double edges[KINKS + 2]) {
  const double whole = discs->large - discs->small, none = discs->large + discs->small;
  const double d = discs->apart;
  const double kinks[KINKS] = {fabs(d - none), fabs(d - whole), d, d + whole, d + none};
  size_t count = 0;
  edges[count++] = from;
  for (double last = from;;) {
    double next = to;
    for (int i = 0; i < KINKS; i++) {
      next = kinks[i] > last && kinks[i] < next ? kinks[i] : next;
    }
    edges[count++] = next;
    if (!(next < to)) {
      return count;
    }
    last = next;
  }
}

/* Sets the nodes of one panel, in ln s, and adds the integrals of p(s) / s times their Lagrange
 * polynomials to weight[PER_PANEL]. first: s may be 0, and the panel is in s. */
static void set_panel(const struct discs *discs, double from, double to, bool first, double *at,
                      double *weight) {
  const double low = first ? from : real_log(from, 0), high = first ? to : real_log(to, 0);
  double place[PER_PANEL], edges[KINKS + 2];
  for (int j = 0; j < PER_PANEL; j++) {
    double sine, cosine; /* Chebyshev's points */
    fn_sincos(FN_PI * (j + 0.5) / PER_PANEL, &sine, &cosine);
    place[j] = low + 0.5 * (1 - cosine) * (high - low);
    at[j] = first ? place[j] : real_exp_signed(place[j]);
    weight[j] = 0;
  }
  const size_t count = find_kinks(discs, from, to, edges);
  for (size_t e = 0; e + 1 < count; e++) {
    const double width = edges[e + 1] - edges[e];
    for (int i = 0; i < POINTS; i++) {
      const double x = core_gauss_node(i), s = edges[e] + width * eased(x);
      const double share = core_gauss_weight(i) * ease_slope(x) * width * density(discs, s) / s;
      const double here = first ? s : real_log(s, 0);
      for (int j = 0; j < PER_PANEL; j++) {
        double lagrange = 1;
        for (int k = 0; k < PER_PANEL; k++) {
          lagrange *= k == j ? 1 : (here - place[k]) / (place[j] - place[k]);
        }
        weight[j] += share * lagrange;
      }
    }
  }
  for (int j = 0; j < PER_PANEL; j++) {
    weight[j] *= at[j];
  }
}

/* The panels of two discs: `count` with equal steps of ln s from `from` to `most`, and one before
 * them, in s, if the discs overlap. */
struct panels {
  double from;
  double most;
  double step;
  int count;
  bool overlap;
};

static struct discs discs_of(double distance_mm, double source_mm, double detector_mm) {
  return (struct discs){0.5 * real_max(source_mm, detector_mm),
                        0.5 * real_min(source_mm, detector_mm), distance_mm};
}

static struct panels panels_of(const struct discs *discs) {
  const double reach = discs->large + discs->small;
  const double most = discs->apart + reach, least = discs->apart - reach;
  const bool overlap = !(least > NEAREST * most);
  const double from = overlap ? NEAREST * most : least;
  const double panels = ceil(real_log(most / from, 0) / real_log(PANEL_RATIO, 0));
  const int count = (int)real_min(real_max(panels, 1), PANELS_MOST - 1);
  return (struct panels){from, most, real_log(most / from, 0) / count, count, overlap};
}

size_t fit_disc_count(double distance_mm, double source_mm, double detector_mm) {
  const struct discs discs = discs_of(distance_mm, source_mm, detector_mm);
  const struct panels panels = panels_of(&discs);
  return discs.large > 0 ? PER_PANEL * (size_t)(panels.count + panels.overlap) : 1;
}

size_t fit_disc_nodes(double distance_mm, double source_mm, double detector_mm, double *at,
                      double *weight) {
  const struct discs discs = discs_of(distance_mm, source_mm, detector_mm);
  if (!(discs.large > 0)) {
    at[0] = distance_mm;
    weight[0] = 1;
    return 1;
  }
  const struct panels panels = panels_of(&discs);
  size_t n = 0;
  if (panels.overlap) {
    const double least = discs.apart - discs.large - discs.small;
    set_panel(&discs, real_max(least, 0), panels.from, true, at, weight);
    n = PER_PANEL;
  }
  double start = panels.from;
  for (int i = 0; i < panels.count; i++, n += PER_PANEL) {
    const double end =
        i + 1 < panels.count ? panels.from * real_exp_signed(panels.step * (i + 1)) : panels.most;
    set_panel(&discs, start, end, false, at + n, weight + n);
    start = end;
  }
  return n;
}
