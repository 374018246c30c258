/* Measures light gathered from points: a sphere of 40 mm lit by a lamp, skin1 in three channels,
 * transport by table. The queries lie on the sphere too, between the points, and are taken in the
 * order that core_gather_order() gives them. A sample of them is taken in runs of neighbours from all
 * over that order, and times are extrapolated; --long takes all of them at the tolerance 1e-2.
 *
 *   gather.build                      s, a million points, one thread
 *   gather.<tolerance>.query          us of processor time; so are all further figures in us
 *   gather.<tolerance>.worst          largest error found, relative
 *   gather.points.1e<n>.query         us at 1e-2, by the number of points, with as many queries
 *   gather.million.1e<n>.query        the same with a million queries: where points are denser than
 *                                     queries, fewer share a list
 *   gather.angle.<tolerance>.query    us, by the criterion of solid angle at equal measured error,
 *                                     down to the tolerance 1e-3: below, a query takes some 50 ms
 *   gather.angle.<tolerance>.worst    that error
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/gather/gather.h"
#include "core/splitmix.h"
#include "tests/bench/bench.h"

enum { CHANNELS = 3, MILLION = 1000000, RUN = 500, COMPARED = 200 };

/* ---- the scene ------------------------------------------------------------------------------- */

typedef struct scene {
  size_t n;
  double *xyz;
  float *power;
  core_gather_points *points;
  double build_s;
} scene;

/* Sets x to a random place on the sphere. */
static void place(uint64_t *random, double x[3]) {
  const double z = 2 * core_splitmix_f64(random) - 1;
  const double around = 2 * 3.14159265358979323846 * core_splitmix_f64(random);
  const double r = sqrt(1 - z * z);
  x[0] = 40 * r * cos(around);
  x[1] = 40 * r * sin(around);
  x[2] = 40 * z;
}

static scene make_scene(size_t n) {
  static const double colour[CHANNELS] = {1, 0.9, 0.7};
  scene made = {n, bench_allocate(3 * n * sizeof(double)),
                bench_allocate(CHANNELS * n * sizeof(float)), NULL, 0};
  uint64_t random = 1;
  for (size_t i = 0; i < n; i++) {
    double *x = made.xyz + 3 * i;
    place(&random, x);
    const double lit = fmax((x[2] + 0.5 * x[0]) / 40, 0) + 0.05;
    for (size_t c = 0; c < CHANNELS; c++) {
      made.power[CHANNELS * i + c] = (float)(lit * colour[c] / (double)n);
    }
  }
  const uint64_t start = bench_own_ns();
  made.points = core_gather_points_create(n, made.xyz, CHANNELS, made.power);
  bench_fail_if(made.points == NULL, "no memory is left");
  while (!core_gather_points_build(made.points, 1000000)) {
  }
  made.build_s = (double)(bench_own_ns() - start) * 1e-9;
  return made;
}

static void free_scene(scene *made) {
  core_gather_points_free(made->points);
  free(made->xyz);
  free(made->power);
}

static core_profile profiles[CHANNELS];
static const core_profile *const profile_list[CHANNELS] = {profiles, profiles + 1, profiles + 2};

static void prepare_profiles(void) {
  const core_measured_medium *skin = core_measured_medium_by_name("skin1");
  for (size_t c = 0; c < CHANNELS; c++) {
    bench_fail_if(core_profile_prepare(&profiles[c], core_isa_select(NULL), CORE_MODEL_TRANSPORT,
                                       CORE_MOMENTS_EXACT, CORE_EVALUATOR_LUT, &skin->channel[c],
                                       NULL)
                          .field != NULL,
                  "a measured medium was refused");
  }
}

static core_gather_sum *make_sum(double tolerance) {
  core_gather_sum *sum;
  bench_fail_if(
      core_gather_sum_prepare(&sum, core_isa_select(NULL), CHANNELS, profile_list, tolerance)
              .field != NULL,
      "a sum was refused");
  return sum;
}

/* ---- queries --------------------------------------------------------------------------------- */

typedef struct query_set {
  size_t n;
  double *xyz;
  uint32_t *order;
  double *M;
} query_set;

static query_set make_queries(const scene *of, size_t n) {
  query_set made = {n, bench_allocate(3 * n * sizeof(double)), bench_allocate(n * sizeof(uint32_t)),
                    bench_allocate(CHANNELS * n * sizeof(double))};
  uint64_t random = 2;
  for (size_t i = 0; i < n; i++) {
    place(&random, made.xyz + 3 * i);
  }
  core_gather_order(of->points, n, made.xyz, made.order);
  return made;
}

static void free_queries(query_set *made) {
  free(made->xyz);
  free(made->order);
  free(made->M);
}

/* Returns the microseconds of a query, in every `stride`th run. */
static double gather_runs(const scene *of, const core_gather_sum *sum, const query_set *queries,
                          size_t stride) {
  core_gather_visits visits = {0};
  core_gather_scratch *scratch = core_gather_scratch_create(sum, of->points);
  const uint64_t start = bench_own_ns();
  for (size_t run = 0; run < queries->n / RUN; run += stride) {
    core_gather(sum, of->points, scratch, RUN, queries->order + run * RUN, queries->xyz, queries->M,
                NULL, &visits);
  }
  const double us = (double)(bench_own_ns() - start) * 1e-3 / (double)visits.queries;
  core_gather_scratch_free(scratch);
  return us;
}

/* Sets M of some queries, spread over all. */
static void gather_some(const scene *of, const core_gather_sum *sum, const query_set *queries,
                        size_t count, double *M) {
  uint32_t some[COMPARED];
  core_gather_visits visits = {0};
  core_gather_scratch *scratch = core_gather_scratch_create(sum, of->points);
  for (size_t i = 0; i < count; i++) {
    some[i] = (uint32_t)(i * (MILLION / COMPARED));
  }
  core_gather(sum, of->points, scratch, count, some, queries->xyz, queries->M, NULL, &visits);
  for (size_t i = 0; i < count; i++) {
    memcpy(M + CHANNELS * i, queries->M + CHANNELS * some[i], CHANNELS * sizeof *M);
  }
  core_gather_scratch_free(scratch);
}

static double worst_error(const double *M, const double *exact, size_t count) {
  double worst = 0;
  for (size_t i = 0; i < CHANNELS * count; i++) {
    worst = fmax(worst, fabs(M[i] - exact[i]) / exact[i]);
  }
  return worst;
}

/* ---- the criterion of solid angle ------------------------------------------------------------ */

/* The tree of Jensen and Buhler 2002, section 3.2, as pbrt-v2 builds it (Pharr, Humphreys 2010,
 * section 16.5): an octree with up to eight points in a leaf. A node stands for its points, at the
 * mean of their places weighted with their power, where its area over the squared distance is below
 * a limit and the query is outside of its box. Here R is evaluated in blocks, by the same kernels. */
enum { ANGLE_LEAF = 8, ANGLE_BLOCK = 512 };

typedef struct angle_node {
  double corner[3], edge;
  double at[3], area;
  double power[CHANNELS];
  struct angle_node *children[8];
  uint32_t points[ANGLE_LEAF];
  uint32_t count; /* of points, if it is a leaf */
  bool inner;
} angle_node;

static angle_node *new_angle_node(const double corner[3], double edge) {
  angle_node *node = calloc(1, sizeof *node);
  bench_fail_if(node == NULL, "no memory is left");
  memcpy(node->corner, corner, sizeof node->corner);
  node->edge = edge;
  return node;
}

static void insert_point(angle_node *node, const scene *of, uint32_t point) {
  while (node->inner || node->count == ANGLE_LEAF) {
    const bool split = !node->inner;
    node->inner = true;
    for (uint32_t i = split ? node->count + 1 : 1; i-- > 0;) {
      const uint32_t moved = split && i > 0 ? node->points[i - 1] : point;
      const double *x = of->xyz + 3 * (size_t)moved;
      double corner[3];
      int octant = 0;
      for (int k = 0; k < 3; k++) {
        const bool upper = x[k] >= node->corner[k] + 0.5 * node->edge;
        octant |= upper << k;
        corner[k] = node->corner[k] + (upper ? 0.5 * node->edge : 0);
      }
      if (node->children[octant] == NULL) {
        node->children[octant] = new_angle_node(corner, 0.5 * node->edge);
      }
      if (i > 0) {
        insert_point(node->children[octant], of, moved);
      } else {
        node = node->children[octant];
        break;
      }
    }
  }
  node->points[node->count++] = point;
}

static double weigh(double at[3], const double x[3], const double power[CHANNELS]) {
  const double weight = (power[0] + power[1] + power[2]) / CHANNELS;
  for (int k = 0; k < 3; k++) {
    at[k] += weight * x[k];
  }
  return weight;
}

static void sum_up(angle_node *node, const scene *of) {
  double weight = 0;
  for (uint32_t i = 0; !node->inner && i < node->count; i++) {
    double power[CHANNELS];
    for (int c = 0; c < CHANNELS; c++) {
      power[c] = (double)of->power[CHANNELS * (size_t)node->points[i] + (size_t)c];
      node->power[c] += power[c];
    }
    weight += weigh(node->at, of->xyz + 3 * (size_t)node->points[i], power);
    node->area += 4 * 3.14159265358979323846 * 40 * 40 / (double)of->n;
  }
  for (int i = 0; node->inner && i < 8; i++) {
    angle_node *child = node->children[i];
    if (child != NULL) {
      sum_up(child, of);
      for (int c = 0; c < CHANNELS; c++) {
        node->power[c] += child->power[c];
      }
      weight += weigh(node->at, child->at, child->power);
      node->area += child->area;
    }
  }
  for (int k = 0; k < 3; k++) {
    node->at[k] /= weight;
  }
}

static void free_angle_node(angle_node *node) {
  for (int i = 0; i < 8 && node != NULL; i++) {
    free_angle_node(node->children[i]);
  }
  free(node);
}

static angle_node *make_angle_tree(const scene *of) {
  const double corner[3] = {-64, -64, -64};
  angle_node *root = new_angle_node(corner, 128);
  for (size_t i = 0; i < of->n; i++) {
    insert_point(root, of, (uint32_t)i);
  }
  sum_up(root, of);
  return root;
}

/* The distances and powers that are waiting to be evaluated. */
typedef struct angle_block {
  const double *x;
  double limit;
  double *M;
  size_t n;
  float r[ANGLE_BLOCK];
  float R[ANGLE_BLOCK];
  double power[CHANNELS][ANGLE_BLOCK];
} angle_block;

static void flush_block(angle_block *block) {
  for (size_t c = 0; c < CHANNELS; c++) {
    core_eval_f32(&profiles[c], CORE_QUANTITY_R, block->n, block->r, block->R);
    for (size_t i = 0; i < block->n; i++) {
      block->M[c] += block->power[c][i] * (double)block->R[i];
    }
  }
  block->n = 0;
}

static double square_distance(const double a[3], const double b[3]) {
  const double x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
  return x * x + y * y + z * z;
}

static void gather_by_angle(const angle_node *node, const scene *of, angle_block *block) {
  const double square = square_distance(block->x, node->at);
  bool inside = true;
  for (int k = 0; k < 3; k++) {
    inside =
        inside && block->x[k] >= node->corner[k] && block->x[k] <= node->corner[k] + node->edge;
  }
  if (block->n + ANGLE_LEAF > ANGLE_BLOCK) {
    flush_block(block);
  }
  if (!inside && node->area < block->limit * square) {
    block->r[block->n] = sqrtf((float)square);
    for (int c = 0; c < CHANNELS; c++) {
      block->power[c][block->n] = node->power[c];
    }
    block->n++;
    return;
  }
  for (int i = 0; node->inner && i < 8; i++) {
    if (node->children[i] != NULL) {
      gather_by_angle(node->children[i], of, block);
    }
  }
  for (uint32_t i = 0; !node->inner && i < node->count; i++) {
    const size_t point = node->points[i];
    block->r[block->n] = sqrtf((float)square_distance(block->x, of->xyz + 3 * point));
    for (size_t c = 0; c < CHANNELS; c++) {
      block->power[c][block->n] = (double)of->power[CHANNELS * point + c];
    }
    block->n++;
  }
}

/* Gathers at the query q by solid angle. */
static void angle_query(const angle_node *root, const scene *of, double limit, const double *x,
                        double M[CHANNELS]) {
  static angle_block block;
  block.x = x;
  block.limit = limit;
  block.M = M;
  memset(M, 0, CHANNELS * sizeof *M);
  gather_by_angle(root, of, &block);
  flush_block(&block);
}

static double angle_error(const angle_node *root, const scene *of, const query_set *queries,
                          double limit, const double *exact) {
  static double M[CHANNELS * COMPARED];
  for (size_t i = 0; i < COMPARED; i++) {
    angle_query(root, of, limit, queries->xyz + 3 * i * (MILLION / COMPARED), M + CHANNELS * i);
  }
  return worst_error(M, exact, COMPARED);
}

/* Returns the microseconds of a query by solid angle, with the limit at which its worst error is the
 * given one. */
static double angle_us(const angle_node *root, const scene *of, const query_set *queries,
                       double error, const double *exact, double *found) {
  double least = 1e-4, most = 1;
  for (int i = 0; i < 7; i++) {
    const double middle = sqrt(least * most);
    *(angle_error(root, of, queries, middle, exact) > error ? &most : &least) = middle;
  }
  *found = angle_error(root, of, queries, least, exact);
  const size_t stride = 1000;
  size_t count = 0;
  const uint64_t start = bench_own_ns();
  for (size_t run = 0; run < MILLION / RUN; run += stride) {
    for (size_t i = 0; i < RUN; i++, count++) {
      double M[CHANNELS];
      angle_query(root, of, least, queries->xyz + 3 * (size_t)queries->order[run * RUN + i], M);
    }
  }
  return (double)(bench_own_ns() - start) * 1e-3 / (double)count;
}

/* ---- figures --------------------------------------------------------------------------------- */

static void measure_tolerance(const scene *of, const query_set *queries, const angle_node *root,
                              const double *exact, double tolerance, size_t stride) {
  static double M[CHANNELS * COMPARED];
  core_gather_sum *sum = make_sum(tolerance);
  gather_some(of, sum, queries, COMPARED, M);
  const double error = worst_error(M, exact, COMPARED);
  bench_figure(gather_runs(of, sum, queries, stride), "us", "gather.%.0e.query", tolerance);
  bench_figure(error, "1", "gather.%.0e.worst", tolerance);
  if (root != NULL) {
    double found;
    const double angle = angle_us(root, of, queries, error, exact, &found);
    bench_figure(angle, "us", "gather.angle.%.0e.query", tolerance);
    bench_figure(found, "1", "gather.angle.%.0e.worst", tolerance);
  }
  core_gather_sum_free(sum);
}

/* Measures one number of points with so many queries. `name`: what the figures begin with. */
static void measure_size(const scene *of, size_t query_count, const char *name, size_t power) {
  query_set queries = make_queries(of, query_count);
  core_gather_sum *sum = make_sum(1e-2);
  const size_t stride = query_count / RUN < 20 ? 1 : query_count / RUN / 20;
  bench_figure(gather_runs(of, sum, &queries, stride), "us", "gather.%s.1e%zu.query", name, power);
  core_gather_sum_free(sum);
  free_queries(&queries);
}

static void measure_sizes(void) {
  for (size_t n = 10000, power = 4; n <= (bench_is_long ? 10000000 : 1000000); n *= 10, power++) {
    scene made = make_scene(n);
    measure_size(&made, n, "points", power);
    measure_size(&made, MILLION, "million", power);
    free_scene(&made);
  }
}

void bench_gather(void) {
  static double exact[CHANNELS * COMPARED];
  bench_progress("gather: building");
  prepare_profiles();
  scene made = make_scene(MILLION);
  query_set queries = make_queries(&made, MILLION);
  bench_figure(made.build_s, "s", "gather.build");
  core_gather_sum *plain = make_sum(0);
  gather_some(&made, plain, &queries, COMPARED, exact);
  core_gather_sum_free(plain);
  angle_node *root = make_angle_tree(&made);
  for (double tolerance = 1e-1; tolerance > (bench_is_long ? 5e-5 : 5e-4); tolerance /= 10) {
    const bool is_usual = bench_is_long && tolerance > 5e-3 && tolerance < 5e-2;
    bench_progress("gather: by tolerance and by solid angle");
    measure_tolerance(&made, &queries, tolerance > 5e-4 ? root : NULL, exact, tolerance,
                      is_usual        ? 1
                      : bench_is_long ? 10
                                      : 50);
  }
  free_angle_node(root);
  free_scene(&made);
  free_queries(&queries);
  bench_progress("gather: numbers of points");
  measure_sizes();
  for (size_t c = 0; c < CHANNELS; c++) {
    core_profile_free(&profiles[c]);
  }
  bench_progress("");
}
