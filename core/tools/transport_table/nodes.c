#include "core/tools/transport_table/nodes.h"
#include "core/tools/tools.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/solver/solver.h"
#include "core/transport/decay.h"
#include "core/transport/functions.h"
#include "core/transport/table.h"

enum {
  PANELS = TRANSPORT_TABLE_PANELS,
  SIDES = TRANSPORT_TABLE_SIDES,
  /* The number of points in each direction. For isotropic scattering they suffice for the last
   * coefficients to be below the quantum. */
  NODES_T = 72,
  NODES_X = 32,
  NODES_D_X_MAX = 28,
  NODES_D_BELOW_1 = 10,
  NODES_D_FROM_1 = 16,
  NODES_D_V = NODES_D_BELOW_1 + NODES_D_FROM_1,
  TOTALS_G = 18,
  TOTALS_U = 31,
  TOTALS_V = 32, /* points of v on each side of eta = 1 */
  DIMENSIONS_MAX = 4,
  BYTES_MAX = 1 << 22
};

/* Where R is smaller, per squared reduced mean free path, rounding errors of the solver are as
 * large as R; from R_DOUBTFUL on they do not count. */
#define R_NOISE 1e-18
#define R_DOUBTFUL 1e-17

/* Returns cos(pi (i + 1/2) k / n). */
static double wave(size_t k, size_t i, size_t n) {
  double sine, cosine;
  fn_sincos(FN_PI * (double)((2 * i + 1) * k % (4 * n)) / (double)(2 * n), &sine, &cosine);
  return cosine;
}

/* Returns the point at an angle of k pi / (2 n): from `to` at k = 0 to `from` at k = 2 n. */
static double point_at(size_t k, size_t n, double from, double to) {
  double sine, cosine;
  fn_sincos(FN_PI * (double)k / (double)(2 * n), &sine, &cosine);
  return from + (to - from) * 0.5 * (1 + cosine);
}

/* Returns Chebyshev's point i of n between two ends. */
static double point(size_t i, size_t n, double from, double to) {
  return point_at(2 * i + 1, n, from, to);
}

/* ---- points ---------------------------------------------------------------------------------- */

/* The panels of D: how many radii each has, and how many terms in y the table keeps. Further terms are
 * nothing but the solver's noise, which would put kinks into profiles. With 20 radii and 16 terms, R is up
 * to 1.8e-3 off beyond x = 1, where D of media with g below 0 that absorb most falls by 1.5 within a mean
 * free path for a large eta (1.2e-4 with 28 and 24), and up to 6.8e-4 off before, for g = 0.95 (4.5e-4
 * with 24 and 20). The last panel is smooth (smooth_far()). */
static const struct {
  size_t radii, kept;
} panel_d[PANELS] = {{20, 10}, {24, 20}, {NODES_D_X_MAX, 24}, {20, 12}};

/* Returns the number of radii of D in all panels before p. */
static size_t first_radius(size_t p) {
  size_t first = 0;
  for (size_t i = 0; i < p; i++) {
    first += panel_d[i].radii;
  }
  return first;
}

/* Sets x to the radii of all panels. */
static void make_radii(const double *field, bool of_difference, double albedo, double *x) {
  double edge[PANELS + 1];
  transport_table_edges(field, of_difference, transport_kappa(albedo), edge);
  for (size_t p = 0; p < PANELS; p++) {
    const size_t n = of_difference ? panel_d[p].radii : NODES_X;
    for (size_t k = 0; k < n; k++) {
      *x++ = fn_exp(point(k, n, edge[p], edge[p + 1]));
    }
  }
}

/* Sets etas to the points of one side of eta = 1. */
static void make_etas(const double *field, enum transport_table_side side, size_t n, double *etas) {
  double range[2];
  transport_table_v_range(field, side, range);
  for (size_t j = 0; j < n; j++) {
    etas[j] = transport_table_eta(side, point(j, n, range[0], range[1]));
  }
}

void nodes_make(const double *field, table_sample samples[NODES]) {
  const double t_first = transport_table_t(field[TRANSPORT_TABLE_ALBEDO_MOST]);
  const double t_last = transport_table_t(field[TRANSPORT_TABLE_ALBEDO_LEAST]);
  double etas[NODES];
  make_etas(field, TRANSPORT_TABLE_BELOW_1, NODES_BELOW_1, etas);
  make_etas(field, TRANSPORT_TABLE_FROM_1, NODES_FROM_1, etas + NODES_BELOW_1);
  for (size_t j = 0; j < NODES; j++) {
    sample_make(&samples[j], 0, NODES_T, PANELS * NODES_X);
    for (size_t i = 0; i < NODES_T; i++) {
      samples[j].eta[i] = etas[j];
      samples[j].albedo[i] = transport_table_albedo(point(i, NODES_T, t_first, t_last));
      make_radii(field, false, samples[j].albedo[i], samples[j].x + i * samples[j].radii);
    }
  }
}

static double w_point(const double *field, size_t l, size_t n) {
  return point(l, n, transport_table_w(field[TRANSPORT_TABLE_G_LEAST]),
               transport_table_w(field[TRANSPORT_TABLE_G_MOST]));
}

static double u_point(const double *field, size_t i, size_t n) {
  return point(i, n, transport_table_u(1), transport_table_u(field[TRANSPORT_TABLE_ALBEDO_LEAST]));
}

/* Samples of the difference lie at the extrema of T_(n - 1) in w and in u, in descending order of g and
 * ascending order of the albedo. They include both ends, next to which zeros of a polynomial leave the
 * largest errors: below g = 0 up to 27 times as large. */
static double sample_w(const double *field, size_t l) {
  return point_at(2 * l, NODES_D_G - 1, transport_table_w(field[TRANSPORT_TABLE_G_LEAST]),
                  transport_table_w(field[TRANSPORT_TABLE_G_MOST]));
}

/* With 14 points in place of 29, R is up to 1.7e-3 off between them, beyond 10 mean free paths for eta
 * from 1 to 1.1. */
static double sample_u(const double *field, size_t i) {
  /* sigma_a / sigma_s' next to both ends, where the solver's range of sigma_a ends */
  static const double ends[] = {99.99, 1.0001e-6};
  return i == 0 || i == NODES_D_U - 1
             ? transport_table_u(1 / (1 + ends[i > 0]))
             : point_at(2 * i, NODES_D_U - 1, transport_table_u(1),
                        transport_table_u(field[TRANSPORT_TABLE_ALBEDO_LEAST]));
}

double nodes_albedo_between(const double *field, size_t i) {
  const double u = sample_u(field, i), next = sample_u(field, i + 1);
  return transport_table_albedo_of_u(u + 0.5 * (next - u));
}

/* Returns the index of the sample at point l of g and point i of u; g is not 0. */
static size_t sample_of(size_t l, size_t i) {
  return (l > NODES_D_G_ZERO ? l - 1 : l) * NODES_D_U + i;
}

static void make_node(const double *field, double g, double albedo, table_sample *sample) {
  sample_make(sample, g, NODES_D_V, first_radius(PANELS));
  sample->level = sample_level(g);
  make_etas(field, TRANSPORT_TABLE_BELOW_1, NODES_D_BELOW_1, sample->eta);
  make_etas(field, TRANSPORT_TABLE_FROM_1, NODES_D_FROM_1, sample->eta + NODES_D_BELOW_1);
  for (size_t j = 0; j < NODES_D_V; j++) {
    sample->albedo[j] = albedo;
    make_radii(field, true, albedo, sample->x + j * sample->radii);
  }
}

void nodes_make_difference(const double *field, table_sample samples[NODES_D]) {
  for (size_t l = 0; l < NODES_D_G; l++) {
    for (size_t i = 0; i < NODES_D_U && l != NODES_D_G_ZERO; i++) {
      make_node(field, transport_table_g(sample_w(field, l)),
                transport_table_albedo_of_u(sample_u(field, i)), &samples[sample_of(l, i)]);
    }
  }
}

/* ---- series ---------------------------------------------------------------------------------- */

/* Replaces values at Chebyshev's points by the coefficients of their series, along one direction of
 * an array: n numbers that are `stride` apart. */
static void transform(double *values, size_t n, size_t stride) {
  double out[TRANSPORT_TABLE_TERMS_MAX];
  for (size_t k = 0; k < n; k++) {
    double sum = 0;
    for (size_t i = 0; i < n; i++) {
      sum += values[i * stride] * wave(k, i, n);
    }
    out[k] = sum * (k == 0 ? 1 : 2) / (double)n;
  }
  for (size_t k = 0; k < n; k++) {
    values[k * stride] = out[k];
  }
}

/* An array of values or terms whose last index is the fastest. */
struct shape {
  size_t dimensions;
  size_t n[DIMENSIONS_MAX];
};

/* Returns the number of elements from dimension d on. */
static size_t size_from(const struct shape *shape, size_t d) {
  size_t size = 1;
  for (; d < shape->dimensions; d++) {
    size *= shape->n[d];
  }
  return size;
}

/* Transforms an array along all directions, the last one first. */
static void transform_all(double *values, const struct shape *shape) {
  const size_t size = size_from(shape, 0);
  for (size_t d = shape->dimensions; d-- > 0;) {
    const size_t n = shape->n[d], stride = size_from(shape, d + 1);
    for (size_t line = 0; line < size / n; line++) {
      transform(values + line / stride * n * stride + line % stride, n, stride);
    }
  }
}

/* ---- bytes ----------------------------------------------------------------------------------- */

static void put_number(uint8_t *at, uint64_t value, size_t bytes) {
  for (size_t i = 0; i < bytes; i++) {
    at[i] = (uint8_t)(value >> 8 * i);
  }
}

static void put_double(uint8_t *at, double value) {
  uint64_t bits;
  memcpy(&bits, &value, sizeof bits);
  put_number(at, bits, sizeof bits);
}

static void put_byte(table_bytes *writer, size_t byte) {
  if (writer->length == BYTES_MAX) {
    tools_fail("the table is too large");
  }
  writer->bytes[writer->length++] = (uint8_t)byte;
}

static void put_integer(table_bytes *writer, int64_t value) {
  uint64_t zigzag = value < 0 ? (uint64_t)(-2 * value - 1) : (uint64_t)(2 * value);
  for (; zigzag >= 0x80; zigzag >>= 7) {
    put_byte(writer, (zigzag & 0x7f) | 0x80);
  }
  put_byte(writer, zigzag);
}

/* Returns the length of a row without its trailing zeros. */
static size_t used(const int64_t *row, size_t n) {
  while (n > 0 && row[n - 1] == 0) {
    n--;
  }
  return n;
}

/* Writes the terms from dimension d on: their number without the zeros at their end, but at least
 * `least`, and each of them. */
static void put_terms(table_bytes *writer, const int64_t *terms, const struct shape *shape,
                      size_t d, size_t least) {
  if (d == shape->dimensions) {
    put_integer(writer, *terms);
    return;
  }
  const size_t stride = size_from(shape, d + 1);
  const size_t last = (used(terms, shape->n[d] * stride) + stride - 1) / stride;
  const size_t count = last > least ? last : least;
  put_byte(writer, count);
  for (size_t i = 0; i < count; i++) {
    put_terms(writer, terms + i * stride, shape, d + 1, 0);
  }
}

/* Writes the series through values at Chebyshev's points, which it overwrites. keep: the number of
 * terms in the first direction that are not left out. */
static void put_series(table_bytes *writer, double quantum, double *values,
                       const struct shape *shape, size_t keep) {
  transform_all(values, shape);
  const size_t size = size_from(shape, 0), kept = keep * size_from(shape, 1);
  int64_t *rounded = tools_allocate(size, sizeof *rounded);
  for (size_t i = 0; i < kept; i++) {
    const double value = values[i] / quantum;
    if (!(fabs(value) < 0x1p47)) {
      tools_fail("a coefficient of the table is too large or not a number");
    }
    rounded[i] = llrint(value);
  }
  put_terms(writer, rounded, shape, 0, 1);
  free(rounded);
}

/* ---- isotropic scattering --------------------------------------------------------------------- */

/* Returns the quotient Q that the table holds (core/transport/table.h) at node k of panel p. */
static double quotient(const table_sample *sample, size_t i, size_t p, size_t k) {
  const size_t at = (i * PANELS + p) * NODES_X + k;
  const double x = sample->x[at];
  const double kx = transport_kappa(sample->albedo[i]) * x;
  return fn_log(x * sample->R[at] / sample->albedo[i]) + kx - fn_log(1 + kx);
}

static void put_side(table_bytes *writer, double quantum, const table_sample *samples, size_t nv) {
  double *values = tools_allocate(NODES_X * NODES_T * nv, sizeof *values);
  for (size_t i = 0; i < NODES_T; i++) {
    for (size_t j = 0; j < nv; j++) {
      values[i * nv + j] = fn_log(samples[j].total[i] / samples[j].albedo[i]);
    }
  }
  put_series(writer, quantum, values, &(struct shape){3, {1, NODES_T, nv}}, 1);
  for (size_t p = 0; p < PANELS; p++) {
    for (size_t k = 0; k < NODES_X; k++) {
      for (size_t i = 0; i < NODES_T; i++) {
        for (size_t j = 0; j < nv; j++) {
          values[(k * NODES_T + i) * nv + j] = quotient(&samples[j], i, p, k);
        }
      }
    }
    put_series(writer, quantum, values, &(struct shape){3, {NODES_X, NODES_T, nv}}, NODES_X);
  }
  free(values);
}

/* Writes a series that is 0. */
static void put_zero(table_bytes *writer) {
  double zero = 0;
  put_series(writer, 1, &zero, &(struct shape){4, {1, 1, 1, 1}}, 1);
}

table_bytes nodes_encode(const double *field, const table_sample samples[NODES]) {
  table_bytes writer = {tools_allocate(BYTES_MAX, 1), TRANSPORT_TABLE_HEADER_BYTES};
  const double quantum = field[TRANSPORT_TABLE_QUANTUM];
  put_side(&writer, quantum, samples, NODES_BELOW_1);
  put_side(&writer, quantum, samples + NODES_BELOW_1, NODES_FROM_1);
  writer.isotropic = writer.length;
  for (size_t i = 0; i < SIDES * (2 + PANELS); i++) {
    put_zero(&writer);
  }
  return writer;
}

/* ---- the difference --------------------------------------------------------------------------- */

/* The totals at the points of g and u, for the boundaries of one side: [g][u][eta]. */
struct totals {
  const double *field;
  enum transport_table_side side;
  solver_total (*at)[TOTALS_V];
};

static void solve_totals(void *context, size_t li) {
  const struct totals *totals = context;
  const double *field = totals->field;
  double etas[TOTALS_V];
  make_etas(field, totals->side, TOTALS_V, etas);
  const solver_phase phase = {transport_table_g(w_point(field, li / TOTALS_U, TOTALS_G)), 0, NULL};
  const double albedo = transport_table_albedo_of_u(u_point(field, li % TOTALS_U, TOTALS_U));
  tools_check(solver_totals(totals->at[li], core_isa_select(NULL), (1 - albedo) / albedo, &phase,
                            etas, TOTALS_V),
              "transport");
}

static void put_totals(table_bytes *writer, const struct totals *totals, bool diffuse) {
  double *values = tools_allocate(TOTALS_G * TOTALS_U * TOTALS_V, sizeof *values);
  for (size_t li = 0; li < TOTALS_G * TOTALS_U; li++) {
    const double albedo =
        transport_table_albedo_of_u(u_point(totals->field, li % TOTALS_U, TOTALS_U));
    for (size_t j = 0; j < TOTALS_V; j++) {
      const solver_total *at = &totals->at[li][j];
      values[li * TOTALS_V + j] = fn_log((diffuse ? at->diffuse : at->normal).value / albedo);
    }
  }
  put_series(writer, totals->field[TRANSPORT_TABLE_TOTALS_QUANTUM], values,
             &(struct shape){4, {1, TOTALS_G, TOTALS_U, TOTALS_V}}, 1);
  free(values);
}

/* Returns D at a radius x from R there. kappa: of the medium. isotropic: the medium's isotropic
 * counterpart. */
static double difference(double x, double R, double kappa, const transport_series *isotropic) {
  const double kx = kappa * x, kx_isotropic = isotropic->kappa * x;
  return fn_log(x * R) + kx - transport_series_at(isotropic, fn_log(x)) -
         fn_log((1 + kx) / (1 + kx_isotropic));
}

static double weighted_sum(size_t n, const double *weight, const double *a, const double *b) {
  double sum = 0;
  for (size_t k = 0; k < n; k++) {
    sum += weight[k] * a[k] * b[k];
  }
  return sum;
}

static void add_multiple(size_t n, double *to, double factor, const double *from) {
  for (size_t k = 0; k < n; k++) {
    to[k] += factor * from[k];
  }
}

/* Returns D at the outer end of panel p, where all Chebyshev polynomials are 1, from D at its radii. */
static double at_outer_end(const double *values, size_t p) {
  double term[NODES_D_X_MAX], sum = 0;
  memcpy(term, values, panel_d[p].radii * sizeof *term);
  transform(term, panel_d[p].radii, 1);
  for (size_t k = 0; k < panel_d[p].kept; k++) {
    sum += term[k];
  }
  return sum;
}

/* Replaces D at the n radii of the last panel by a polynomial in 1 / x through it, by least squares:
 * there R is diffusion, whose terms these are, and the slope at the reach, with which D continues,
 * has hardly any of the solver's noise. That noise grows with x. At x_begin, where the panel
 * begins, D is `begin`: if the two panels did not meet there, joining them
 * (transport_join_panels()) would move both, by up to 3e-3 where R is noise beyond x_begin. The
 * polynomials are made orthogonal; one that the radii hardly tell from those before it is left
 * out, with all that follow. */
static void smooth_far(size_t n, double x_begin, double begin, const double *x, const double *R,
                       double *values) {
  enum { TERMS = 3 };
  const double told_apart = 0.04;
  double weight[NODES_D_X_MAX], polynomial[TERMS][NODES_D_X_MAX], rest[NODES_D_X_MAX];
  for (size_t k = 0; k < n; k++) {
    const double trusted = R[k] > R_NOISE ? R[k] / (R[k] + R_DOUBTFUL) : 0;
    weight[k] = trusted * trusted / (x[k] * x[k]);
    rest[k] = values[k] - begin;
    values[k] = begin;
  }
  for (size_t j = 0; j < TERMS; j++) {
    double *of = polynomial[j];
    for (size_t k = 0; k < n; k++) {
      of[k] = (j == 0 ? 1 : polynomial[j - 1][k]) * (1 - x_begin / x[k]);
    }
    const double before = weighted_sum(n, weight, of, of);
    for (size_t i = 0; i < j; i++) {
      add_multiple(n, of, -weighted_sum(n, weight, of, polynomial[i]), polynomial[i]);
    }
    const double square = weighted_sum(n, weight, of, of);
    if (!(square > told_apart * told_apart * before)) {
      break;
    }
    for (size_t k = 0; k < n; k++) {
      of[k] /= sqrt(square);
    }
    add_multiple(n, values, weighted_sum(n, weight, of, rest), of);
  }
}

/* Sets values to D at the radii of medium j of a sample. Where R is below R_NOISE, D keeps the
 * value that it has at the last radius before. */
static void find_differences(const transport_table *isotropic, const table_sample *sample, size_t j,
                             double *values) {
  const double kappa = transport_anisotropic_kappa(sample->albedo[j], sample->g);
  const double *x = sample->x + j * sample->radii, *R = sample->R + j * sample->radii;
  transport_series series;
  transport_table_look_up(isotropic, sample->albedo[j], 0, sample->eta[j], &series);
  double last = 0;
  for (size_t p = 0; p < PANELS; p++) {
    for (size_t k = panel_d[p].radii; k-- > 0;) { /* the radii of a panel descend */
      const size_t at = first_radius(p) + k;
      last = R[at] > R_NOISE ? difference(x[at], R[at], kappa, &series) : last;
      values[at] = last;
    }
  }
  const size_t before = PANELS - 2, far = first_radius(PANELS - 1);
  smooth_far(panel_d[PANELS - 1].radii, isotropic->field[TRANSPORT_TABLE_D_EDGES + PANELS - 1],
             at_outer_end(values + first_radius(before), before), x + far, R + far, values + far);
}

/* Sets weight[i] such that the sum of weight[i] f(x[i]) is, at the point `at`, the polynomial of
 * degree n - 1 through f at n points x (Lagrange). */
static void interpolate(size_t n, const double *x, double at, double *weight) {
  for (size_t i = 0; i < n; i++) {
    weight[i] = 1;
    for (size_t k = 0; k < n; k++) {
      weight[i] *= k == i ? 1 : (at - x[k]) / (x[i] - x[k]);
    }
  }
}

/* Adds D of one g, at all radii and boundaries of a side, to values at Chebyshev's points of u:
 * [x of all panels][g][u][eta]. */
static void add_differences(const transport_table *isotropic, const table_sample samples[NODES_D],
                            size_t l, size_t first, size_t nv, double *values) {
  const double *field = isotropic->field;
  double u[NODES_D_U], weight[NODES_D_U][NODES_D_U], of_medium[PANELS * NODES_D_X_MAX];
  for (size_t i = 0; i < NODES_D_U; i++) {
    u[i] = sample_u(field, i);
  }
  for (size_t to = 0; to < NODES_D_U; to++) {
    interpolate(NODES_D_U, u, u_point(field, to, NODES_D_U), weight[to]);
  }
  for (size_t i = 0; i < NODES_D_U; i++) {
    for (size_t j = 0; j < nv; j++) {
      find_differences(isotropic, &samples[sample_of(l, i)], first + j, of_medium);
      for (size_t k = 0; k < first_radius(PANELS); k++) {
        for (size_t to = 0; to < NODES_D_U; to++) {
          values[((k * NODES_D_G + l) * NODES_D_U + to) * nv + j] += weight[to][i] * of_medium[k];
        }
      }
    }
  }
}

/* Replaces D at the samples' points of g by D at Chebyshev's points. stride: how far apart the
 * values of two g are in the array; lines: its length in all other directions. */
static void move_to_chebyshev(const double *field, size_t lines, size_t stride, double *values) {
  double w[NODES_D_G], weight[NODES_D_G][NODES_D_G], at[NODES_D_G];
  for (size_t l = 0; l < NODES_D_G; l++) {
    w[l] = sample_w(field, l);
  }
  for (size_t to = 0; to < NODES_D_G; to++) {
    interpolate(NODES_D_G, w, w_point(field, to, NODES_D_G), weight[to]);
  }
  for (size_t line = 0; line < lines; line++) {
    double *first = values + line / stride * NODES_D_G * stride + line % stride;
    for (size_t l = 0; l < NODES_D_G; l++) {
      at[l] = first[l * stride];
    }
    for (size_t to = 0; to < NODES_D_G; to++) {
      first[to * stride] = 0;
      for (size_t l = 0; l < NODES_D_G; l++) {
        first[to * stride] += weight[to][l] * at[l];
      }
    }
  }
}

static void put_differences(table_bytes *writer, const transport_table *isotropic,
                            const table_sample samples[NODES_D], enum transport_table_side side) {
  const size_t first = side == TRANSPORT_TABLE_BELOW_1 ? 0 : NODES_D_BELOW_1;
  const size_t nv = side == TRANSPORT_TABLE_BELOW_1 ? NODES_D_BELOW_1 : NODES_D_FROM_1;
  const size_t radii = first_radius(PANELS), media = NODES_D_G * NODES_D_U * nv;
  double *values = tools_allocate(radii * media, sizeof *values);
  for (size_t l = 0; l < NODES_D_G; l++) {
    if (l != NODES_D_G_ZERO) { /* D is 0 if g is 0 */
      add_differences(isotropic, samples, l, first, nv, values);
    }
  }
  move_to_chebyshev(isotropic->field, radii * NODES_D_U * nv, NODES_D_U * nv, values);
  for (size_t p = 0; p < PANELS; p++) {
    put_series(writer, isotropic->field[TRANSPORT_TABLE_D_QUANTUM],
               values + first_radius(p) * media,
               &(struct shape){4, {panel_d[p].radii, NODES_D_G, NODES_D_U, nv}}, panel_d[p].kept);
  }
  free(values);
}

void nodes_encode_difference(table_bytes *table, const table_sample samples[NODES_D]) {
  transport_table isotropic;
  if (!transport_table_open(&isotropic, table->bytes, table->length)) {
    tools_fail("the table cannot be read");
  }
  struct totals totals = {isotropic.field, 0,
                          tools_allocate(TOTALS_G * TOTALS_U, sizeof *totals.at)};
  table_bytes writer = {tools_allocate(BYTES_MAX, 1), table->isotropic};
  memcpy(writer.bytes, table->bytes, writer.length);
  for (enum transport_table_side side = 0; side < TRANSPORT_TABLE_SIDES; side++) {
    totals.side = side;
    tools_each(tools_processors(), TOTALS_G * TOTALS_U, solve_totals, &totals);
    put_totals(&writer, &totals, false);
    put_totals(&writer, &totals, true);
    put_differences(&writer, &isotropic, samples, side);
  }
  nodes_seal(writer, isotropic.field);
  transport_table_close(&isotropic);
  free(totals.at);
  free(table->bytes);
  *table = writer;
}

void nodes_seal(table_bytes table, const double *field) {
  memcpy(table.bytes, TRANSPORT_TABLE_MAGIC, 8);
  put_number(table.bytes + 8, TRANSPORT_TABLE_VERSION, 4);
  put_number(table.bytes + 12, table.length, 4);
  for (size_t i = 0; i < TRANSPORT_TABLE_FIELDS; i++) {
    put_double(table.bytes + 24 + 8 * i, field[i]);
  }
  put_number(table.bytes + 16, transport_table_checksum(table.bytes + 24, table.length - 24), 8);
}
