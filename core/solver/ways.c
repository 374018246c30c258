/* Light that is scattered at the distance h from the boundary that it meets first, at the angle theta
 * in its layer, x = tan(theta), leaves at r = h x + sum of N_l d_l tan(theta_l), where N_l counts how
 * often it crosses layer l. So, over all ways,
 *
 *   R1(r) = 1 / r sum int du cos^2(theta) sigma_s B p(cos) e^(-s h / mu) prod e^(-s_l N_l d_l / mu_l)
 *           prod (T or 1 - T),   x = sinh u,
 *
 * where B is the beam at the place of scattering. h falls as x grows: from the layer's thickness to 0. */
#include "core/solver/ways.h"

#include <assert.h>
#include <math.h>
#include <string.h>

#include "core/transport/functions.h"
#include "core/transport/gauss.h"
#include "core/transport/single.h"

static double index_of(const ways *of, ptrdiff_t layer) {
  return layer < 0 ? 1 : (size_t)layer >= of->layers ? of->index_below : of->layer[layer].index;
}

/* ---- finding the ways by which light leaves -------------------------------------------------- */

/* Follows light upwards or downwards from a boundary of a layer, and records each way by which it
 * leaves, as far as there is room. */
static void follow_light(ways *to, ways_path at, size_t layer, bool upwards) {
  const size_t boundary = layer + !upwards;
  if ((isinf(to->layer[layer].thickness) && !upwards) || to->count == WAYS_MAX) {
    return; /* it meets no further boundary */
  }
  const ptrdiff_t next = (ptrdiff_t)layer + (upwards ? -1 : 1);
  ways_path passed = at;
  passed.through[boundary]++;
  if (next < 0 || (size_t)next == to->layers) {
    passed.side = next < 0 ? 0 : 1;
    to->way[to->count++] = passed;
  } else {
    passed.full[next]++;
    follow_light(to, passed, (size_t)next, upwards);
  }
  if (at.reflections < to->reflections_most &&
      index_of(to, (ptrdiff_t)layer) != index_of(to, next)) {
    at.reflections++;
    at.back[boundary]++;
    at.full[layer]++;
    follow_light(to, at, layer, !upwards);
  }
}

static double reflectance(const ways *of, size_t boundary) {
  return solver_beam_reflectance(index_of(of, (ptrdiff_t)boundary - 1),
                                 index_of(of, (ptrdiff_t)boundary));
}

static double passed_by_beam(const stack_layer *layer) {
  return fn_exp(-layer->extinction * layer->thickness);
}

static void find_beams(ways *to) {
  for (unsigned q = 0; q <= to->reflections_most; q++) {
    /* with exactly q reflections */
    double down[SOLVER_LAYERS_MAX] = {0}, up[SOLVER_LAYERS_MAX] = {0};
    for (size_t i = 0; i < to->layers; i++) {
      down[i] = i > 0 ? down[i - 1] * passed_by_beam(&to->layer[i - 1]) * (1 - reflectance(to, i))
                : q == 0 ? 1
                         : 0;
      down[i] += q > 0 ? to->up[i][q - 1] * passed_by_beam(&to->layer[i]) * reflectance(to, i) : 0;
    }
    for (size_t i = to->layers; i-- > 0;) {
      up[i] = i + 1 < to->layers
                  ? up[i + 1] * passed_by_beam(&to->layer[i + 1]) * (1 - reflectance(to, i + 1))
                  : 0;
      up[i] +=
          q > 0 ? to->down[i][q - 1] * passed_by_beam(&to->layer[i]) * reflectance(to, i + 1) : 0;
    }
    for (size_t i = 0; i < to->layers; i++) {
      to->down[i][q] = down[i];
      to->up[i][q] = up[i];
    }
  }
  for (size_t i = 0; i < to->layers; i++) {
    for (unsigned q = 1; q <= to->reflections_most; q++) {
      to->down[i][q] += to->down[i][q - 1];
      to->up[i][q] += to->up[i][q - 1];
    }
  }
}

/* Light of a way with more reflections, which has crossed a thin layer more often, has a kink in r where
 * it leaves at the critical angle. Ways that cross a depth of CROSSED, or more than WAYS_MANY, do not
 * count, but for one reflection. */
#define CROSSED 5.0
enum { WAYS_MANY = 64 };

/* Returns the least depth of adjacent layers of one index. */
static double least_depth(const stack_layer *layer, size_t layers) {
  double least = (double)INFINITY, depth = 0;
  for (size_t i = 0; i < layers; i++) {
    depth += layer[i].extinction * layer[i].thickness;
    if (i + 1 == layers || layer[i + 1].index != layer[i].index) {
      least = fmin(least, depth);
      depth = 0;
    }
  }
  return least;
}

void solver_ways_find(ways *to, const stack_layer *layer, size_t layers, double below) {
  assert(layers >= 1 && layers <= SOLVER_LAYERS_MAX);
  const double crossings = CROSSED / least_depth(layer, layers);
  unsigned reflections =
      crossings < STACK_REFLECTIONS_MAX ? (unsigned)crossings : STACK_REFLECTIONS_MAX;
  reflections = reflections > 1 ? reflections : 1;
  do {
    memset(to, 0, sizeof *to);
    to->layer = layer;
    to->layers = layers;
    to->index_below = below;
    to->reflections_most = reflections;
    for (size_t i = 0; i < layers; i++) {
      follow_light(to, (ways_path){.layer = i, .upwards = true}, i, true);
      follow_light(to, (ways_path){.layer = i, .upwards = false}, i, false);
    }
  } while (to->count > WAYS_MANY && reflections-- > 1);
  assert(to->count < WAYS_MAX);
  find_beams(to);
}

/* ---- values ----------------------------------------------------------------------------------------- */

/* A ray's directions in all layers, by Snell's law: above the stack, in each layer, below. */
struct ray {
  double mu[SOLVER_LAYERS_MAX + 2];   /* cosines; 0 where total reflection leaves no ray */
  double sine[SOLVER_LAYERS_MAX + 2]; /* that of mu, but where a cosine has lost its digits */
};

#define SINE_SMALL 1e-5

static struct ray ray_at(const ways *of, size_t layer, double x) {
  struct ray ray;
  const double sine = of->layer[layer].index * x / sqrt(1 + x * x);
  for (size_t i = 0; i < of->layers + 2; i++) {
    const double s = sine / index_of(of, (ptrdiff_t)i - 1);
    ray.mu[i] = i == layer + 1 ? 1 / sqrt(1 + x * x) : s < 1 ? sqrt((1 - s) * (1 + s)) : 0;
    ray.sine[i] = s < SINE_SMALL ? s : sqrt((1 - ray.mu[i]) * (1 + ray.mu[i]));
  }
  return ray;
}

/* Returns the lateral distance of a way, except in its own part of its layer. Infinite if light is
 * totally reflected. */
static double length_of(const ways *of, const ways_path *way, double x) {
  const struct ray ray = ray_at(of, way->layer, x);
  double sum = 0;
  for (size_t i = 0; i < of->layers; i++) {
    const double mu = ray.mu[i + 1];
    if (way->full[i] > 0) {
      sum +=
          mu > 0 ? way->full[i] * of->layer[i].thickness * ray.sine[i + 1] / mu : (double)INFINITY;
    }
  }
  const bool leaves = ray.mu[way->side == 0 ? 0 : of->layers + 1] > 0;
  return leaves ? sum : (double)INFINITY;
}

#define X_MOST 1e9

/* Solves length_of() + x own = r for x, up to X_MOST. */
static double find_x(const ways *of, const ways_path *way, double own, double r) {
  double low = 0, high = X_MOST;
  if (length_of(of, way, high) + own * high <= r) {
    return high;
  }
  for (int i = 0; i < 90; i++) {
    const double middle = low > 1e-3 ? 0.5 * (low + high)
                          : high > 1 ? sqrt(1e-6 * high)
                                     : 0.5 * (low + high);
    if (length_of(of, way, middle) + own * middle <= r) {
      low = middle;
    } else {
      high = middle;
    }
  }
  return low;
}

/* Returns the integrand of R1 at u. */
static double light_at(const ways *of, const ways_path *way, double u, double r) {
  const double e = fn_exp(u), x = 0.5 * (e - 1 / e);
  const stack_layer *own = &of->layer[way->layer];
  const struct ray ray = ray_at(of, way->layer, x);
  const double mu = ray.mu[way->layer + 1];
  const double h = fmax(0, r - length_of(of, way, x)) / x;
  const solver_phase phase = {.g = own->g};
  const size_t left = of->reflections_most - way->reflections;
  const double z = fmax(0, way->upwards ? h : own->thickness - h);
  double lit = of->down[way->layer][left] > 0
                   ? of->down[way->layer][left] * fn_exp(-own->extinction * z) *
                         solver_phase_at(&phase, way->upwards ? -mu : mu)
                   : 0;
  if (of->up[way->layer][left] > 0) {
    lit += of->up[way->layer][left] * fn_exp(-own->extinction * (own->thickness - z)) *
           solver_phase_at(&phase, way->upwards ? mu : -mu);
  }
  double depth = own->extinction * h / mu;
  for (size_t i = 0; i < of->layers; i++) {
    depth += way->full[i] > 0
                 ? way->full[i] * of->layer[i].extinction * of->layer[i].thickness / ray.mu[i + 1]
                 : 0;
  }
  double passes = fn_exp(-depth);
  for (size_t i = 0; i <= of->layers && passes > 0; i++) {
    const double above = index_of(of, (ptrdiff_t)i - 1), below = index_of(of, (ptrdiff_t)i);
    const double mu1 = ray.mu[i], mu2 = ray.mu[i + 1];
    const double t = above == below       ? 1
                     : mu1 > 0 && mu2 > 0 ? transport_transmittance(above / below, mu1, mu2)
                                          : 0;
    for (unsigned k = 0; k < way->through[i]; k++) {
      passes *= t;
    }
    for (unsigned k = 0; k < way->back[i]; k++) {
      passes *= 1 - t;
    }
  }
  return mu * mu * own->sigma_s / (4 * FN_PI) * lit * passes;
}

/* Returns the mean over phi of int e^(-(excess h + i k (own h + lateral) cos(phi))) dh, h from 0 to
 * `thickness`. */
static double complex mean_wave(double complex k, double excess, double own, double lateral,
                                double thickness) {
  enum { NODES = 16, NODES_MOST = 96 };
  const double turns = fn_abs(k) * (own * thickness + lateral);
  const size_t nodes = turns < NODES_MOST - NODES ? NODES + (size_t)turns : NODES_MOST;
  double complex sum = 0;
  for (size_t i = 0; i < nodes; i++) {
    double sine, cosine;
    fn_sincos(FN_PI * ((double)i + 0.5) / (double)nodes, &sine, &cosine);
    const double complex wave = CMPLX(0, cosine) * k, rate = excess + own * wave;
    const double complex depth = rate * thickness;
    const double complex passed = fn_norm2(depth) < 1e-8 ? thickness * (1 - 0.5 * depth)
                                                         : (1 - fn_cexp(-depth)) * fn_inverse(rate);
    sum += fn_cexp(-lateral * wave) * passed;
  }
  return sum / (double)nodes;
}

double complex solver_ways_onwards(const ways *of, double complex k) {
  enum { PANELS = 25, NODES = 6 };
  static const double widening = 1.33;
  gauss_rule rule;
  transport_gauss(&rule, NODES);
  double complex sum = 0;
  for (size_t i = isinf(creal(k)) ? of->layers - 1 : 0; i < of->layers; i++) {
    const stack_layer *own = &of->layer[i];
    const solver_phase phase = {.g = own->g};
    double end = 0.5 * FN_PI;
    for (size_t panel = 0; panel < PANELS; panel++) {
      const double begin = panel + 1 < PANELS ? end / widening : 0;
      for (size_t node = 0; node < rule.n; node++) {
        double sine, cosine;
        fn_sincos(begin + (end - begin) * rule.x[node], &sine, &cosine);
        const struct ray ray = ray_at(of, i, sine / cosine);
        double depth = 0, lateral = 0, passes = 1;
        for (size_t j = i + 1; j <= of->layers; j++) {
          const double mu1 = ray.mu[j], mu2 = ray.mu[j + 1];
          const double eta = index_of(of, (ptrdiff_t)j - 1) / index_of(of, (ptrdiff_t)j);
          passes *= eta == 1 ? 1
                    : mu1 > 0 && mu2 > 0
                        ? transport_transmittance(eta, mu1, mu2) / (1 - reflectance(of, j))
                        : 0;
          if (j < of->layers && passes > 0) {
            depth += of->layer[j].extinction * of->layer[j].thickness * (1 / mu2 - 1);
            lateral += of->layer[j].thickness * ray.sine[j + 1] / mu2;
          }
        }
        if (passes > 0) {
          const double complex wave = isinf(creal(k))
                                          ? cosine / sine
                                          : mean_wave(k, own->extinction * (1 / cosine - 1),
                                                      sine / cosine, lateral, own->thickness);
          sum += (end - begin) * rule.weight[node] * 0.5 * sine * own->sigma_s *
                 solver_phase_at(&phase, cosine) * passes * fn_exp(-depth) * wave;
        }
      }
      end = begin;
    }
  }
  return sum;
}

#define U_MOST 21.0
#define PANEL_FIRST 0.02
#define PANEL_MOST 0.3

static double integrate(const ways *of, const ways_path *way, const gauss_rule *rule, double r) {
  const stack_layer *own = &of->layer[way->layer];
  const double first = isinf(own->thickness) ? 0 : find_x(of, way, own->thickness, r);
  const double last = find_x(of, way, 0, r);
  const double from = fn_log(first + sqrt(1 + first * first));
  const double to = fmin(fn_log(last + sqrt(1 + last * last)), from + U_MOST);
  double sum = 0, begin = from, width = PANEL_FIRST * (1 - fabs(own->g));
  while (begin < to) {
    /* the last panel ends at a root of the integrand */
    const bool ends = begin + 1.5 * width >= to;
    const double end = ends ? to : begin + width;
    for (size_t i = 0; i < rule->n; i++) {
      const double v = rule->x[i], w = rule->weight[i];
      const double u = ends ? end - (end - begin) * v * v : begin + (end - begin) * v;
      sum += (end - begin) * w * (ends ? 2 * v : 1) * light_at(of, way, u, r);
    }
    begin = end;
    width = fmin(PANEL_MOST, 2 * width);
  }
  return sum / r;
}

double solver_ways_at(const ways *of, size_t side, double r) {
  enum { NODES = 16 };
  gauss_rule rule;
  transport_gauss(&rule, NODES);
  double sum = 0;
  for (size_t i = 0; i < of->count; i++) {
    if (of->way[i].side == side) {
      sum += integrate(of, &of->way[i], &rule, r);
    }
  }
  return sum;
}
