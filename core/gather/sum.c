/* Gathers: selects, for each cell of queries, the nodes that replace their points, and computes the
 * sums.
 *
 * A cell is the cube of a node with at most 80 points, or a cube of about a leaf's size between
 * such nodes. A district is the cube of a node with at most 1,024 points. All queries of a cell
 * share a list: the nodes that replace their points, and the leaves whose points are summed one by
 * one.
 *
 * The list of a district starts with the root. M is estimated by a walk that opens every node whose
 * radius is larger than half its distance. Then the nodes with the largest bounds are opened until
 * the sum B of all bounds is below 0.9 tolerance M in each channel. The list of a cell starts as a
 * copy of its district's list. The cell estimates M with it, computes the bounds again and opens
 * further nodes.
 *
 * Each query has its own M, and B / (M - B) bounds its relative error. If that exceeds the
 * tolerance, the query uses the cell's next list, which has a quarter of the error. After eight
 * lists it sums all points. The values of a query thus depend only on the query, the points and the
 * profiles, and not on the order of queries.
 *
 * Rounding of centroids, and of powers of channels that share moments, takes up to 1/256 of the
 * tolerance, which the bound includes. The error of the profile against its model adds to the bound
 * (core_gather_error()). */
#include <assert.h>
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/gather/bounds.h"
#include "core/gather/loops.h"
#include "core/gather/points.h"
#include "core/kernels.h"
#include "core/lut/lut.h"

/* ---- sums ------------------------------------------------------------------------------------ */

CORE_ISA_TABLE(gather_loops, gather_loops)

struct core_gather_sum {
  const gather_loops *loops;
  size_t channels;
  double tolerance;
  /* shallow copies; the caller owns what they point to */
  core_profile profile[CORE_GATHER_CHANNELS_MAX];
  gather_bounds *bounds; /* [channels], NULL if the tolerance is 0 */
  /* The tables of the evaluator lut. If they are there, all queries of a cell are summed together.
   * NULL for other evaluators. */
  gather_pieces pieces[CORE_GATHER_CHANNELS_MAX];
};

static size_t pieces_of(const core_profile *profile) {
  return (profile->lut_count - CORE_LUT_PIECES - CORE_LUT_SAMPLE_WORDS) / CORE_LUT_TERMS;
}

/* Sets the pieces of a profile's table. Returns false if memory runs out. */
static bool set_pieces(gather_pieces *pieces, const core_profile *profile) {
  const size_t count = pieces_of(profile);
  pieces->stride = count + 2 * GATHER_CLOSE;
  pieces->memory = calloc(CORE_LUT_TERMS * pieces->stride, sizeof *pieces->memory);
  if (pieces->memory == NULL) {
    return false;
  }
  pieces->first = pieces->memory + GATHER_CLOSE;
  for (size_t i = 0; i < count; i++) {
    for (size_t k = 0; k < CORE_LUT_TERMS; k++) {
      pieces->memory[k * pieces->stride + GATHER_CLOSE + i] =
          profile->lut[CORE_LUT_PIECES + CORE_LUT_TERMS * i + k];
    }
  }
  return true;
}

core_fault core_gather_sum_prepare(core_gather_sum **sum, const core_isa *isa, size_t channels,
                                   const core_profile *const *profiles, double tolerance) {
  assert(channels >= 1 && channels <= CORE_GATHER_CHANNELS_MAX);
  *sum = NULL;
  const bool plain = tolerance <= 0 && tolerance >= 0;
  if (!plain &&
      !(tolerance >= CORE_GATHER_TOLERANCE_MIN && tolerance <= CORE_GATHER_TOLERANCE_MAX)) {
    return (core_fault){"tolerance", "0, or 1e-9 to 0.5", 0};
  }
  core_gather_sum *made = calloc(1, sizeof *made);
  gather_bounds *bounds = plain ? NULL : malloc(channels * sizeof *bounds);
  if (made == NULL || (bounds == NULL && !plain)) {
    free(made);
    free(bounds);
    return CORE_OUT_OF_MEMORY;
  }
  made->loops = gather_loops_of[isa->index];
  made->channels = channels;
  made->tolerance = tolerance;
  made->bounds = bounds;
  for (size_t c = 0; c < channels; c++) {
    assert(profiles[c]->evaluator == profiles[0]->evaluator);
    made->profile[c] = *profiles[c];
    if (!plain) {
      gather_bounds_prepare(&bounds[c], profiles[c]);
    }
    if (!plain && profiles[c]->evaluator == CORE_EVALUATOR_LUT &&
        made->loops->look_up_close != NULL && !set_pieces(&made->pieces[c], profiles[c])) {
      core_gather_sum_free(made);
      return CORE_OUT_OF_MEMORY;
    }
  }
  *sum = made;
  return (core_fault){0};
}

void core_gather_sum_free(core_gather_sum *sum) {
  if (sum != NULL) {
    for (size_t c = 0; c < sum->channels; c++) {
      free(sum->pieces[c].memory);
    }
    free(sum->bounds);
    free(sum);
  }
}

/* Returns about how many nodes and points each query visits. Fitted to points on a sphere: 600 to
 * 1,000 visits at tolerance 1e-2 for 1e4 to 1e6 points, and about twice as many for a tenth of the
 * tolerance. */
static double visits_of(const core_gather_sum *sum, const core_gather_points *points) {
  const double n = (double)points->n;
  return sum->tolerance > 0 ? fmin(n, 50 * log2(n + 2) * pow(0.01 / sum->tolerance, 1.0 / 3)) : n;
}

static double test_cost(const core_gather_sum *sum) {
  return 20 + 20 * (double)sum->channels;
}

/* Returns the cost of making the lists of these numbers of cells and districts. Measured: for each
 * visit of a query, making a cell's list tests 0.7 nodes and making a district's list 0.9. */
static double lists_cost(const core_gather_sum *sum, const core_gather_points *points, double cells,
                         double districts) {
  return sum->tolerance > 0
             ? visits_of(sum, points) * test_cost(sum) * (0.7 * cells + 0.9 * districts)
             : 0;
}

static double channel_cost(const core_gather_sum *sum, size_t channel) {
  return core_radius_cost(&sum->profile[channel], CORE_QUANTITY_R);
}

/* Returns the cost of one query's sums, in radii of a dipole. */
static double sums_cost(const core_gather_sum *sum, const core_gather_points *points) {
  double each = 0;
  for (size_t c = 0; c < sum->channels; c++) {
    each += channel_cost(sum, c);
  }
  return visits_of(sum, points) * (sum->tolerance > 0 ? 1 + 2 * each : 2 + each);
}

static bool same_cell(const gather_cell *a, const gather_cell *b) {
  return memcmp(a, b, sizeof *a) == 0;
}

double core_gather_cost(const core_gather_sum *sum, const core_gather_points *points, size_t n,
                        const uint32_t *order, const double *xyz) {
  gather_cell cell = {.edge_mm = 0}, district = cell;
  double cells = 0, districts = 0;
  for (size_t i = 0; i < n && sum->tolerance > 0; i++) {
    const size_t q = order != NULL ? order[i] : i;
    if (gather_cell_holds(&cell, &xyz[3 * q])) {
      continue;
    }
    gather_cell own_district;
    const gather_cell own = gather_cell_of(points, &xyz[3 * q], &own_district);
    cells += i > 0 && same_cell(&own, &cell) ? 0 : 1;
    districts += i > 0 && same_cell(&own_district, &district) ? 0 : 1;
    cell = own;
    district = own_district;
  }
  return (double)n * sums_cost(sum, points) + lists_cost(sum, points, cells, districts);
}

/* ---- scratch --------------------------------------------------------------------------------- */

/* The capacity of a list. If it is exceeded, all points are summed. */
enum { LIST_MAX = 1 << 16 };

/* The first estimate of M uses nodes whose ratio of radius to distance is at most this. */
#define ESTIMATE_ANGLE 0.5

/* The share of the tolerance that the bounds of a list may use. The tolerance is relative to M, the
 * sum itself, which is estimated before it is known: the rest allows for a sum below its estimate.
 */
#define LIST_SHARE 0.9

/* The largest value of `fineness`, the number of finer lists that a cell has made. At this value
 * all points are summed. */
enum { ALL_POINTS = 8 };

/* The list of a cell or district: nodes that replace their points, and leaves whose points are
 * summed one by one. */
typedef struct list {
  gather_cell cell;
  double estimate[CORE_GATHER_CHANNELS_MAX]; /* estimate of M in the cell, W/mm^2 */
  double error[CORE_GATHER_CHANNELS_MAX];    /* sum of the bounds of all nodes, W/mm^2 */
  size_t node_count, leaf_count;
  uint32_t node[LIST_MAX];
  uint32_t leaf[LIST_MAX];
  double node_error[LIST_MAX * CORE_GATHER_CHANNELS_MAX]; /* [place * channels + channel] */
} list;

struct core_gather_scratch {
  const core_gather_sum *sum;
  const core_gather_points *points;
  bool known; /* whether both lists are valid */
  /* a position, and how far it is from the points with power in each channel, at least */
  double near_to[CORE_GATHER_CHANNELS_MAX][3]; /* unset where that is 0 */
  double near_mm[CORE_GATHER_CHANNELS_MAX];
  list district, list; /* `list` is of the present cell, and starts as a copy of `district` */
  int fineness;
  /* The batch: queries of one cell whose sums are under way. The members after it are its progress;
   * core_gather_on() may stop between two steps. */
  uint32_t batch[GATHER_QUERIES];
  size_t batch_count; /* 0: no batch is under way */
  /* number of the batch's queries, the first ones, whose present list is not summed yet */
  size_t left;
  size_t tried,
      /* of this district: registers of radii that look_up_close() tried, and could not evaluate */
      missed;
  /* `left` rounded up to a multiple of GATHER_CLOSE if all queries are summed together, else 0 */
  size_t together;
  size_t step; /* next step of the block: a query, or with `together` some of the nodes or points */
  size_t node, group; /* the block's first node in the list, and the group of channels */
  /* the position after the block: a leaf in the list, and a point in that leaf */
  size_t leaf, point;
  size_t filled; /* number of points in the block */
  /* The arrays of one block, which are evaluated together: */
  gather_rows rows;
  _Alignas(64) double share[GATHER_NODES];
  double at[3][GATHER_POINTS + GATHER_LANES];
  double power[CORE_GATHER_CHANNELS_MAX][GATHER_POINTS + GATHER_LANES];
  double r[GATHER_RADII]; /* distances of points, or of nodes: two for each, mm */
  double R[GATHER_RADII];
  _Alignas(64) float narrow_r[GATHER_RADII];
  _Alignas(64) float narrow_R[GATHER_RADII];
  _Alignas(64) double x[3][GATHER_QUERIES]; /* the batch's queries, if they are summed together */
  /* their lane sums over the block */
  double part[CORE_GATHER_CHANNELS_MAX][GATHER_LANES][GATHER_QUERIES];
  double added[GATHER_QUERIES][CORE_GATHER_CHANNELS_MAX];
  /* compensation of each sum's rounding (Neumaier 1974) */
  double lost[GATHER_QUERIES][CORE_GATHER_CHANNELS_MAX];
};

core_gather_scratch *core_gather_scratch_create(const core_gather_sum *sum,
                                                const core_gather_points *points) {
  assert(points->build == NULL && points->channels == sum->channels);
  core_gather_scratch *scratch = aligned_alloc(64, sizeof(core_gather_scratch));
  if (scratch != NULL) {
    scratch->sum = sum;
    scratch->points = points;
    scratch->known = false;
    memset(scratch->near_mm, 0, sizeof scratch->near_mm);
    scratch->batch_count = 0;
    scratch->tried = scratch->missed = 0;
  }
  return scratch;
}

void core_gather_scratch_free(core_gather_scratch *scratch) {
  free(scratch);
}

size_t core_gather_scratch_bytes(void) {
  return sizeof(core_gather_scratch);
}

/* ---- the list of a cell ---------------------------------------------------------------------- */

typedef struct walk {
  const core_gather_sum *sum;
  const core_gather_points *points;
  core_gather_scratch *s;
  core_gather_visits *visits;
  double *work; /* cost that is left until core_gather_on() returns, in radii of a dipole */
} walk;

/* Computes the bounds of up to GATHER_LANES nodes at these places of a list, for each channel. They
 * hold for all queries of the list's cell. */
static void find_errors(const walk *w, list *l, size_t count, const uint32_t *places) {
  const core_gather_points *points = w->points;
  /* Closer nodes are opened: rounding of their centroid would exceed its share of the tolerance. */
  const double least_distance = points->reach_mm * 0x1p-41 / w->sum->tolerance;
  w->visits->tested += count;
  *w->work -= (double)count * test_cost(w->sum);
  for (size_t group = 0; group < points->groups; group++) {
    gather_seen seen;
    gather_views views;
    for (size_t k = 0; k < GATHER_LANES; k++) {
      const size_t node = l->node[places[k < count ? k : 0]];
      const double *moments = points->moments[node * points->groups + group].at;
      for (size_t field = 0; field < GATHER_SEEN_FIELDS; field++) {
        seen.field[field][k] = moments[field];
      }
    }
    w->sum->loops->view(&seen, l->cell.at, l->cell.radius_mm, &views);
    for (size_t k = 0; k < count; k++) {
      const double *power = &points->node_power[l->node[places[k]] * points->channels];
      const bool rounded = seen.field[3][k] > 0 && views.nearest[k] < least_distance;
      double *error = &l->node_error[places[k] * points->channels];
      for (size_t c = 0; c < points->channels; c++) {
        if (points->group[c] == group) {
          const double each = w->sum->loops->error(&w->sum->bounds[c], &views, k);
          error[c] = !(power[c] > 0 && each > 0) ? 0 : rounded ? (double)INFINITY : power[c] * each;
        }
      }
    }
  }
}

/* Replaces the node at a place of the list by its children, or moves it to the leaves. Returns false
 * if the list is full. */
static bool open_node(const walk *w, list *l, size_t place) {
  const uint32_t at = l->node[place];
  const gather_node *node = &w->points->nodes[at];
  if (node->children == 0) {
    if (l->leaf_count == LIST_MAX) {
      return false;
    }
    l->leaf[l->leaf_count++] = at;
    l->node_count--;
    l->node[place] = l->node[l->node_count];
    const size_t channels = w->points->channels;
    memcpy(&l->node_error[place * channels], &l->node_error[l->node_count * channels],
           channels * sizeof l->node_error[0]);
    return true;
  }
  if (l->node_count + node->children > LIST_MAX) {
    return false;
  }
  uint32_t places[GATHER_LANES];
  for (uint32_t i = 0; i < node->children; i++) {
    places[i] = (uint32_t)(i == 0 ? place : l->node_count++);
    l->node[places[i]] = node->child + i;
  }
  find_errors(w, l, node->children, places);
  return true;
}

static void start_list(const walk *w, list *l) {
  l->leaf_count = 0;
  l->node_count = 1;
  l->node[0] = 0;
  find_errors(w, l, 1, (const uint32_t[1]){0});
}

/* Adds an estimate of a node's contribution to M to the list's estimate. */
static void add_estimate(const walk *w, list *l, uint32_t node) {
  const core_gather_points *points = w->points;
  const gather_moments *m = &points->moments[node * points->groups];
  const double distance = gather_distance(l->cell.at, m->at);
  const double r = fmax(distance, 0.5 * fmax(m->radius_mm, l->cell.radius_mm));
  for (size_t c = 0; c < points->channels; c++) {
    l->estimate[c] +=
        points->node_power[node * points->channels + c] * gather_about(&w->sum->bounds[c], r);
  }
}

/* Estimates M in the cell with nodes whose radius is at most ESTIMATE_ANGLE times their distance,
 * and makes them the list. Returns false if they are too many. */
static bool estimate_by_angle(const walk *w, list *l) {
  const core_gather_points *points = w->points;
  memset(l->estimate, 0, sizeof l->estimate);
  l->node_count = 1;
  l->node[0] = 0;
  while (l->node_count > 0) {
    const uint32_t at = l->node[--l->node_count];
    const gather_node *node = &points->nodes[at];
    const gather_moments *m = &points->moments[at * points->groups];
    if (node->children == 0 ||
        m->radius_mm <= ESTIMATE_ANGLE * gather_distance(l->cell.at, m->at)) {
      add_estimate(w, l, at);
      continue;
    }
    for (uint32_t i = 0; i < node->children; i++) {
      l->node[l->node_count++] = node->child + i;
    }
    if (l->node_count + 8 > LIST_MAX) {
      return false;
    }
  }
  return true;
}

/* Estimates M in the cell with the list's nodes and leaves. */
static void estimate_by_list(const walk *w, list *l) {
  memset(l->estimate, 0, sizeof l->estimate);
  for (size_t i = 0; i < l->node_count; i++) {
    add_estimate(w, l, l->node[i]);
  }
  for (size_t i = 0; i < l->leaf_count; i++) {
    add_estimate(w, l, l->leaf[i]);
  }
}

static void add_errors(const walk *w, list *l) {
  const size_t channels = w->points->channels;
  double sum[CORE_GATHER_CHANNELS_MAX] = {0};
  for (size_t i = 0; i < l->node_count * channels; i += channels) {
    for (size_t c = 0; c < channels; c++) {
      sum[c] += l->node_error[i + c];
    }
  }
  memcpy(l->error, sum, sizeof sum);
}

/* Sets budget[channels] to `share` times the largest error that the list may have, W/mm^2. */
static void set_budget(const walk *w, const list *l, double share, double *budget) {
  for (size_t c = 0; c < w->points->channels; c++) {
    budget[c] = share * w->sum->tolerance * l->estimate[c];
  }
}

static bool exceeds(const walk *w, const double *error, const double *limit) {
  bool more = false;
  for (size_t c = 0; c < w->points->channels; c++) {
    more = more || error[c] > limit[c];
  }
  return more;
}

/* Opens nodes of the list until the sum of their bounds is within `share` of the tolerance. Returns
 * false if the list is full. */
static bool refine(const walk *w, list *l, double share) {
  double limit[CORE_GATHER_CHANNELS_MAX], budget[CORE_GATHER_CHANNELS_MAX];
  set_budget(w, l, share, budget);
  set_budget(w, l, share / 16, limit);
  for (int round = 0; round < 200; round++) {
    for (size_t i = 0; i < l->node_count;) {
      if (!exceeds(w, &l->node_error[i * w->points->channels], limit)) {
        i++;
      } else if (!open_node(w, l, i)) {
        return false;
      }
    }
    add_errors(w, l);
    if (!exceeds(w, l->error, budget)) {
      return true;
    }
    for (size_t c = 0; c < w->points->channels; c++) {
      if (l->error[c] > budget[c]) {
        const double by = 0.85 * budget[c] / l->error[c];
        limit[c] *= by < 0.125 ? 0.125 : by;
      }
    }
  }
  return false;
}

/* Computes the bounds of the list's nodes again. limit, unless NULL: only of nodes with a larger
 * bound in a channel. */
static void find_larger_errors(const walk *w, list *l, const double *limit) {
  uint32_t places[GATHER_LANES];
  size_t filled = 0;
  for (size_t i = 0; i < l->node_count; i++) {
    if (limit == NULL || exceeds(w, &l->node_error[i * w->points->channels], limit)) {
      places[filled++] = (uint32_t)i;
    }
    if (filled > 0 && (filled == GATHER_LANES || i + 1 == l->node_count)) {
      find_errors(w, l, filled, places);
      filled = 0;
    }
  }
}

/* Makes the list of a district, with which the lists of its cells start. It is refined for the
 * district's centre; then its bounds are computed for the whole district. */
static void make_district(const walk *w, const gather_cell *district) {
  list *l = &w->s->district;
  l->cell = *district;
  l->cell.radius_mm = 0;
  if (!estimate_by_angle(w, l)) {
    memset(l->estimate, 0, sizeof l->estimate);
  }
  start_list(w, l);
  const bool made = refine(w, l, LIST_SHARE);
  l->cell = *district;
  if (!made) {
    start_list(w, l);
  }
  find_larger_errors(w, l, NULL);
}

/* Starts the cell's list as a copy of its district's list. Bounds that are small for the whole
 * district are kept, and the others are computed again for the cell. */
static void start_cell(const walk *w) {
  const list *from = &w->s->district;
  list *l = &w->s->list;
  l->node_count = from->node_count;
  l->leaf_count = from->leaf_count;
  memcpy(l->node, from->node, l->node_count * sizeof *l->node);
  memcpy(l->leaf, from->leaf, l->leaf_count * sizeof *l->leaf);
  estimate_by_list(w, l);
  double small[CORE_GATHER_CHANNELS_MAX];
  set_budget(w, l, LIST_SHARE / (8 * (double)l->node_count), small);
  memcpy(l->node_error, from->node_error,
         l->node_count * w->points->channels * sizeof *l->node_error);
  find_larger_errors(w, l, small);
}

/* Replaces the cell's list by the next finer one. */
static void make_finer(const walk *w) {
  core_gather_scratch *s = w->s;
  list *l = &s->list;
  s->fineness++;
  if (s->fineness == 0) {
    start_cell(w);
  }
  if (s->fineness >= ALL_POINTS || !refine(w, l, LIST_SHARE * ldexp(1, -2 * s->fineness))) {
    s->fineness = ALL_POINTS;
    l->node_count = 0;
    l->leaf_count = 1;
    memset(l->error, 0, sizeof l->error);
  }
}

/* ---- summing --------------------------------------------------------------------------------- */

/* Adds a value to a sum with compensation of rounding errors (Neumaier 1974). */
static void add_compensated(double *sum, double *lost, double value) {
  const double more = *sum + value;
  if (more < (double)INFINITY) {
    *lost += fabs(*sum) >= fabs(value) ? (*sum - more) + value : (value - more) + *sum;
  }
  *sum = more;
}

/* Evaluates R[n] at the distances s->r[n]; n is a multiple of GATHER_LANES. The radii are also in
 * s->narrow_r for the kernels in single precision. */
static void evaluate_R(const core_gather_sum *sum, size_t channel, core_gather_scratch *s,
                       size_t n) {
  const core_profile *profile = &sum->profile[channel];
  if (profile->evaluator == CORE_EVALUATOR_F64) {
    core_eval_f64(profile, CORE_QUANTITY_R, n, s->r, s->R);
    return;
  }
  core_eval_f32(profile, CORE_QUANTITY_R, n, s->narrow_r, s->narrow_R);
  sum->loops->widen(n, s->narrow_R, s->R);
}

static size_t padded(size_t n) {
  return (n + GATHER_LANES - 1) / GATHER_LANES * GATHER_LANES;
}

/* The multiplicity of each field of gather_moments (see gather_rows). */
static const double times[GATHER_FIELDS] = {1, 1, 1, 1, 1, 1, 1, 2, 2, 2, 1, 1, 1,
                                            2, 2, 2, 1, 1, 1, 3, 3, 3, 3, 3, 3, 6};
_Static_assert(sizeof(gather_moments) == GATHER_FIELDS * sizeof(double), "all of them");

/* Prefetches the moments of a node: successive nodes of a list are far apart in memory. */
static void fetch_moments(const core_gather_points *points, size_t node) {
  const char *moments = (const char *)&points->moments[node * points->groups];
  for (size_t i = 0; i < sizeof(gather_moments); i += 64) {
    __builtin_prefetch(moments + i);
  }
}

/* Copies the moments of nodes first to first + count of the list to s->rows, and the powers of the
 * group's channels to s->power. Pads with nodes without power to a multiple of GATHER_LANES, and
 * returns that number. */
static size_t fill_rows(const walk *w, size_t group, size_t first, size_t count) {
  const core_gather_points *points = w->points;
  const size_t n = padded(count);
  for (size_t i = 0; i < n; i += GATHER_LANES) {
    double moments[GATHER_LANES][GATHER_FIELDS];
    for (size_t k = 0; k < GATHER_LANES; k++) {
      const size_t place = i + k < count ? i + k : count - 1;
      const size_t node = w->s->list.node[first + place];
      memcpy(moments[k], &points->moments[node * points->groups + group], sizeof moments[k]);
      if (i + k + 2 * GATHER_LANES < count) {
        fetch_moments(points, w->s->list.node[first + i + k + 2 * GATHER_LANES]);
      }
      for (size_t c = 0; c < points->channels; c++) {
        const bool counts = i + k < count && points->group[c] == group;
        w->s->power[c][i + k] = counts ? points->node_power[node * points->channels + c] : 0;
      }
    }
    for (size_t field = 0; field < GATHER_FIELDS; field++) {
      for (size_t k = 0; k < GATHER_LANES; k++) {
        w->s->rows.field[field][i + k] = times[field] * moments[k][field];
      }
    }
  }
  return n;
}

/* Adds the n nodes of the present block to the sums of query q, which is at x. */
static void add_rows(const walk *w, size_t n, size_t q, const double *x) {
  core_gather_scratch *s = w->s;
  const gather_loops *loops = w->sum->loops;
  loops->pair(n, &s->rows, x, s->r, s->share);
  loops->narrow(2 * n, s->r, s->narrow_r);
  *w->work -= (double)n;
  for (size_t c = 0; c < w->points->channels; c++) {
    if (w->points->group[c] == s->group) {
      evaluate_R(w->sum, c, s, 2 * n);
      add_compensated(&s->added[q][c], &s->lost[q][c],
                      loops->sum_pairs(n, s->power[c], s->share, s->R));
      *w->work -= 2 * (double)n * channel_cost(w->sum, c);
    }
  }
}

/* How many nodes or points of the block a step adds for all queries of the batch together. */
enum { STEP_NODES = 4, STEP_POINTS = GATHER_LANES }; /* rows of part */
_Static_assert(2 * STEP_NODES * GATHER_QUERIES <= GATHER_RADII, "two radii of each");

/* Returns the number of steps for a block of n nodes or points. each: how many a step of a batch
 * adds. */
static size_t steps_of(const core_gather_scratch *s, size_t n, size_t each) {
  return s->together > 0 ? n / each : s->left;
}

/* Evaluates s->narrow_R[n] at the first n radii in s->narrow_r: by look_up_close() while most of
 * its tries succeed, else by the kernel. */
static void look_up(const walk *w, size_t channel, size_t n) {
  core_gather_scratch *s = w->s;
  const core_profile *profile = &w->sum->profile[channel];
  uint64_t missed = w->sum->loops->look_up_close(profile->lut, &w->sum->pieces[channel], n,
                                                 s->narrow_r, s->narrow_R);
  s->tried += n / GATHER_CLOSE;
  /* for each run of adjacent registers that look_up_close() left out */
  for (size_t end = 0; missed != 0;) {
    size_t from = end;
    for (; (missed & 1) == 0; missed >>= 1) {
      from++;
    }
    for (end = from; (missed & 1) != 0; missed >>= 1) {
      end++;
    }
    s->missed += end - from;
    core_eval_f32(profile, CORE_QUANTITY_R, GATHER_CLOSE * (end - from),
                  s->narrow_r + GATHER_CLOSE * from, s->narrow_R + GATHER_CLOSE * from);
  }
}

/* Adds the next STEP_NODES nodes of the block to the lane sums of all queries of the batch. */
static void add_rows_together(const walk *w) {
  core_gather_scratch *s = w->s;
  const gather_loops *loops = w->sum->loops;
  const size_t first = STEP_NODES * s->step;
  loops->close_pairs(STEP_NODES, &s->rows, first, s->together, s->x, s->narrow_r, s->share);
  *w->work -= (double)(STEP_NODES * s->left);
  for (size_t c = 0; c < w->points->channels; c++) {
    if (w->points->group[c] == s->group) {
      look_up(w, c, 2 * STEP_NODES * s->together);
      loops->add_close_pairs(STEP_NODES, &s->power[c][first], s->together, s->share, s->narrow_R,
                             &s->part[c][first % GATHER_LANES]);
      *w->work -= (double)(2 * STEP_NODES * s->left) * channel_cost(w->sum, c);
    }
  }
}

/* Adds the next STEP_POINTS points of the block to the lane sums of all queries of the batch. */
static void add_points_together(const walk *w) {
  core_gather_scratch *s = w->s;
  const gather_loops *loops = w->sum->loops;
  const size_t first = STEP_POINTS * s->step;
  loops->close_distances(STEP_POINTS, &s->at[0][first], &s->at[1][first], &s->at[2][first],
                         s->together, s->x, s->narrow_r);
  *w->work -= (double)(2 * STEP_POINTS * s->left);
  for (size_t c = 0; c < w->points->channels; c++) {
    look_up(w, c, STEP_POINTS * s->together);
    loops->add_close(STEP_POINTS, &s->power[c][first], s->together, s->narrow_R, s->part[c]);
    *w->work -= (double)(STEP_POINTS * s->left) * channel_cost(w->sum, c);
  }
}

/* Adds the lane sums of the present block to the sums of the batch's queries. all_groups: of all
 * channels; else only those of the present group. */
static void add_parts(const walk *w, bool all_groups) {
  core_gather_scratch *s = w->s;
  for (size_t c = 0; c < w->points->channels && s->together > 0; c++) {
    if (all_groups || w->points->group[c] == s->group) {
      for (size_t q = 0; q < s->left; q++) {
        double lanes[GATHER_LANES];
        for (size_t k = 0; k < GATHER_LANES; k++) {
          lanes[k] = s->part[c][k][q];
        }
        add_compensated(&s->added[q][c], &s->lost[q][c], w->sum->loops->total(lanes));
      }
      memset(s->part[c], 0, sizeof s->part[c]);
    }
  }
}

/* Adds the list's nodes to the sums of the batch. Returns false if the work is used up before the
 * end. */
static bool add_nodes(const walk *w, const double *xyz) {
  core_gather_scratch *s = w->s;
  for (; s->node < s->list.node_count; s->node += GATHER_NODES) {
    const size_t rest = s->list.node_count - s->node;
    const size_t count = rest < GATHER_NODES ? rest : GATHER_NODES;
    for (; s->group < w->points->groups; s->group++) {
      const size_t n = s->step == 0 ? fill_rows(w, s->group, s->node, count) : padded(count);
      for (; s->step < steps_of(s, n, STEP_NODES); s->step++) {
        if (!(*w->work > 0)) {
          return false;
        }
        if (s->together > 0) {
          add_rows_together(w);
        } else {
          add_rows(w, n, s->step, &xyz[3 * (size_t)s->batch[s->step]]);
        }
      }
      add_parts(w, false);
      s->step = 0;
    }
    s->group = 0;
    w->visits->nodes += (uint64_t)s->left * count;
  }
  return true;
}

/* Fills the block with the next points of the list's leaves, or with the next of all points. Pads
 * it with points without power to a multiple of GATHER_LANES. */
static void fill_points(const walk *w) {
  core_gather_scratch *s = w->s;
  const core_gather_points *points = w->points;
  const gather_node all = {.first = 0, .count = (uint32_t)points->n};
  while (s->filled < GATHER_POINTS && s->leaf < s->list.leaf_count) {
    const gather_node *leaf =
        s->fineness == ALL_POINTS ? &all : &points->nodes[s->list.leaf[s->leaf]];
    const size_t rest = leaf->count - s->point, room = GATHER_POINTS - s->filled;
    const size_t count = rest < room ? rest : room, first = leaf->first + s->point;
    for (int k = 0; k < 3; k++) {
      memcpy(&s->at[k][s->filled], &points->at[k][first], count * sizeof s->at[0][0]);
    }
    for (size_t c = 0; c < points->channels; c++) {
      w->sum->loops->widen(count, &points->power[c][first], &s->power[c][s->filled]);
    }
    s->filled += count;
    s->point += count;
    if (s->point == leaf->count) {
      s->leaf++;
      s->point = 0;
    }
  }
  for (size_t i = s->filled; i < padded(s->filled); i++) {
    for (int k = 0; k < 3; k++) {
      s->at[k][i] = s->at[k][s->filled - 1];
    }
    for (size_t c = 0; c < points->channels; c++) {
      s->power[c][i] = 0;
    }
  }
}

/* Adds the n points of the present block to the sums of query q, which is at x. */
static void add_block(const walk *w, size_t n, size_t q, const double *x) {
  core_gather_scratch *s = w->s;
  const gather_loops *loops = w->sum->loops;
  loops->distances(n, s->at[0], s->at[1], s->at[2], x, s->r);
  loops->narrow(n, s->r, s->narrow_r);
  *w->work -= 2 * (double)n;
  for (size_t c = 0; c < w->points->channels; c++) {
    evaluate_R(w->sum, c, s, n);
    add_compensated(&s->added[q][c], &s->lost[q][c], loops->sum(n, s->power[c], s->R));
    *w->work -= (double)n * channel_cost(w->sum, c);
  }
}

/* Adds the points of the list's leaves, or all points, to the sums of the batch. Returns false if
 * the work is used up. */
static bool add_points(const walk *w, const double *xyz) {
  core_gather_scratch *s = w->s;
  for (;;) {
    fill_points(w);
    const size_t n = padded(s->filled);
    if (n == 0) {
      return true;
    }
    for (; s->step < steps_of(s, n, STEP_POINTS); s->step++) {
      if (!(*w->work > 0)) {
        return false;
      }
      if (s->together > 0) {
        add_points_together(w);
      } else {
        add_block(w, n, s->step, &xyz[3 * (size_t)s->batch[s->step]]);
      }
    }
    add_parts(w, true);
    w->visits->points += (uint64_t)s->left * s->filled;
    s->step = 0;
    s->filled = 0;
  }
}

/* Computes M and the bound of query q. Returns whether M is within the tolerance in each
 * channel. */
static bool finish_query(const walk *w, size_t q, double *M, float *bound) {
  const core_gather_scratch *s = w->s;
  bool within = true;
  for (size_t c = 0; c < w->points->channels; c++) {
    const double value = s->added[q][c] + s->lost[q][c];
    const double spare =
        s->list.node_count > 0 ? w->sum->tolerance * 0x1p-8 + w->points->uneven[c] : 0;
    const double error = s->list.error[c] > 0 ? s->list.error[c] / (value - s->list.error[c]) : 0;
    const double stated = (error + spare) * (1 + 0x1p-22); /* no float that it becomes is less */
    within = within && value >= s->list.error[c] && stated <= w->sum->tolerance * (1 - 0x1p-22);
    M[c] = value;
    if (bound != NULL) {
      bound[c] = (float)stated;
    }
  }
  return within || s->fineness == ALL_POINTS;
}

/* Clears the sums of the batch's first `left` queries and decides whether they are summed
 * together. */
static void begin_batch(const walk *w, const double *xyz) {
  core_gather_scratch *s = w->s;
  memset(s->added, 0, sizeof s->added);
  memset(s->lost, 0, sizeof s->lost);
  s->step = s->node = s->group = s->leaf = s->point = s->filled = 0;
  /* Summing together computes whole registers, and is slower for radii that are not close. It pays
   * only if enough lanes are used. */
  const size_t lanes = (s->left + GATHER_CLOSE - 1) / GATHER_CLOSE * GATHER_CLOSE;
  const bool faster = 5 * s->left >= 3 * lanes && 5 * s->missed <= s->tried;
  s->together = w->sum->pieces[0].memory != NULL && faster ? lanes : 0;
  for (size_t q = 0; q < s->together; q++) {
    const double *x = &xyz[3 * (size_t)s->batch[q < s->left ? q : s->left - 1]];
    for (size_t k = 0; k < 3; k++) {
      s->x[k][q] = x[k];
    }
  }
  memset(s->part, 0, sizeof s->part);
}

/* Returns a lower bound of the distance from x to the points of a node that have power, at least 7/9
 * of it, or `least` if that is less. */
static double nearest(const core_gather_points *points, size_t channel, uint32_t at,
                      const double *x, double least) {
  const gather_node *node = &points->nodes[at];
  const gather_moments *m = &points->moments[at * points->groups + points->group[channel]];
  const double far = gather_distance(m->at, x), near = far - m->radius_mm;
  if (!(points->node_power[at * points->channels + channel] > 0) || near >= least) {
    return least;
  }
  if (8 * m->radius_mm <= far) {
    return near;
  }
  for (uint32_t i = 0; i < node->children; i++) {
    least = nearest(points, channel, node->child + i, x, least);
  }
  for (size_t i = node->first; node->children == 0 && i < (size_t)node->first + node->count; i++) {
    const double point[3] = {points->at[0][i], points->at[1][i], points->at[2][i]};
    least = points->power[channel][i] > 0 ? fmin(least, gather_distance(point, x)) : least;
  }
  return least;
}

/* Notes how near and how far the points of a query at x are, and its sums M. What is known of a position
 * close to it needs no search. */
static void note_query(const walk *w, const double *x, const double *M) {
  core_gather_scratch *s = w->s;
  core_gather_visits *visits = w->visits;
  const core_gather_points *points = w->points;
  double far[3];
  for (size_t k = 0; k < 3; k++) {
    far[k] = fmax(fabs(x[k] - points->least[k]), fabs(x[k] - points->most[k]));
  }
  visits->farthest_mm = fmax(visits->farthest_mm, gather_distance(far, (const double[3]){0}));
  for (size_t c = 0; c < points->channels; c++) {
    const double least = visits->queries > 0 ? visits->nearest_mm[c] : (double)INFINITY;
    double off = s->near_mm[c] > 0 ? gather_distance(s->near_to[c], x) : 0;
    if (!(off < 0.1 * s->near_mm[c])) {
      memcpy(s->near_to[c], x, sizeof s->near_to[c]);
      s->near_mm[c] = nearest(points, c, 0, x, least);
      off = 0;
    }
    visits->nearest_mm[c] = fmin(least, s->near_mm[c] - off);
    visits->dimmest[c] = visits->queries > 0 ? fmin(visits->dimmest[c], M[c]) : M[c];
  }
  visits->queries++;
}

/* Gathers at the queries of the batch, with finer lists until all are within the tolerance. Returns
 * false if the work is used up before the end. */
static bool gather_batch(const walk *w, const double *xyz, double *M, float *bound) {
  core_gather_scratch *s = w->s;
  const size_t channels = w->points->channels;
  while (add_nodes(w, xyz) && add_points(w, xyz)) {
    size_t left = 0;
    for (size_t q = 0; q < s->left; q++) {
      const size_t at = s->batch[q] * channels;
      if (!finish_query(w, q, M + at, bound != NULL ? bound + at : NULL)) {
        s->batch[left++] = s->batch[q];
      } else {
        note_query(w, &xyz[3 * (size_t)s->batch[q]], M + at);
      }
    }
    s->left = left;
    if (left == 0) {
      return true;
    }
    make_finer(w);
    begin_batch(w, xyz);
  }
  return false;
}

/* Makes a batch of the next queries that share a cell, up to GATHER_QUERIES, and makes the cell's
 * list. */
static void take_batch(const walk *w, size_t n, const uint32_t *order, size_t from,
                       const double *xyz) {
  core_gather_scratch *s = w->s;
  const bool plain = !(w->sum->tolerance > 0);
  gather_cell cell = {.edge_mm = 0}, district = cell;
  size_t count = 0;
  for (; count < GATHER_QUERIES && from + count < n; count++) {
    const uint32_t q = order != NULL ? order[from + count] : (uint32_t)(from + count);
    const double *x = &xyz[3 * (size_t)q];
    if (!plain && !gather_cell_holds(&cell, x)) {
      gather_cell own_district;
      const gather_cell own = gather_cell_of(w->points, x, &own_district);
      if (count > 0 && !same_cell(&own, &cell)) {
        break;
      }
      cell = own;
      district = own_district;
    }
    s->batch[count] = q;
  }
  if (plain) {
    s->fineness = ALL_POINTS - 1;
    make_finer(w);
  } else if (!s->known || !same_cell(&cell, &s->list.cell) || s->fineness > 0) {
    if (!s->known || !same_cell(&district, &s->district.cell)) {
      make_district(w, &district);
      s->tried = s->missed = 0;
    }
    s->list.cell = cell;
    s->fineness = -1;
    make_finer(w);
  }
  s->known = true;
  s->batch_count = s->left = count;
  begin_batch(w, xyz);
}

size_t core_gather_on(const core_gather_sum *sum, const core_gather_points *points,
                      core_gather_scratch *scratch, size_t n, const uint32_t *order,
                      const double *xyz, double *M, float *bound, core_gather_visits *visits,
                      double *work) {
  assert(scratch->sum == sum && scratch->points == points);
  const walk w = {sum, points, scratch, visits, work};
  size_t done = 0;
  while (done<n && * work> 0) {
    if (scratch->batch_count == 0) {
      take_batch(&w, n, order, done, xyz);
    }
    if (gather_batch(&w, xyz, M, bound)) {
      done += scratch->batch_count;
      scratch->batch_count = 0;
    }
  }
  return done;
}

void core_gather(const core_gather_sum *sum, const core_gather_points *points,
                 core_gather_scratch *scratch, size_t n, const uint32_t *order, const double *xyz,
                 double *M, float *bound, core_gather_visits *visits) {
  assert(scratch->batch_count == 0);
  double work = (double)INFINITY;
  core_gather_on(sum, points, scratch, n, order, xyz, M, bound, visits, &work);
}

/* ---- errors ---------------------------------------------------------------------------------- */

/* Returns the largest relative change of R by rounding a distance to single precision. It considers
 * distances up to most_mm at which R has not underflowed. */
static double rounding_error(const core_profile *profile, double most_mm) {
  double steepest = 1;
  /* A downloaded table does not contain scale_mm exactly, only its power of two. */
  for (double r = 1e-4 * ldexp(1, ilogb(profile->scale_mm)); r < 1.05 * most_mm; r *= 1.05) {
    const double far = r < most_mm ? r : most_mm;
    const float radii[2] = {(float)(0.99 * far), (float)far};
    float R[2];
    core_eval_f32(profile, CORE_QUANTITY_R, 2, radii, R);
    if (R[1] > FLT_MIN && R[0] <= FLT_MAX) {
      /* an upper bound of |dR/dr| r / R from two radii 1 % apart */
      steepest = fmax(steepest, 100 * ((double)R[0] / (double)R[1] - 1));
    }
  }
  return 1.1 * steepest * 0x1p-24;
}

static double error_at(const core_profile *profile, double least_mm, double most_mm) {
  const core_stated_errors errors =
      core_profile_errors(profile, CORE_QUANTITY_R, (core_radii_range){least_mm, most_mm});
  return errors.numerical + errors.numerical_per_mm * most_mm;
}

static double R_at(const core_profile *profile, double r_mm) {
  double R;
  float narrow_R, narrow_r = (float)r_mm;
  if (profile->evaluator == CORE_EVALUATOR_F64) {
    core_eval_f64(profile, CORE_QUANTITY_R, 1, &r_mm, &R);
    return R;
  }
  core_eval_f32(profile, CORE_QUANTITY_R, 1, &narrow_r, &narrow_R);
  return (double)narrow_R;
}

/* A larger error leaves R unknown. */
#define UNKNOWN 0.5

/* Returns the error of sums of points from least_mm to most_mm away. The points beyond some distance r
 * may be off by a share of all the light if they sent it from r: then the errors of R beyond r count by
 * little. R falls with the distance where its error is above UNKNOWN, which is far from the source.
 * watts: the power of all points; M: the least sum. */
static double error_of_sums(const core_gather_sum *sum, const core_profile *profile,
                            core_radii_range radii, double watts, double M) {
  const double step = 1.1, first = core_error_edges_mfp[0] / core_sigma_t_prime(&profile->medium);
  double stated = error_at(profile, radii.least_mm, radii.most_mm);
  double off = 0; /* the largest error of R beyond r, 1/mm^2 */
  bool known = true;
  for (double r = radii.most_mm / step; r > fmax(radii.least_mm, first); r /= step) {
    const double share = error_at(profile, r, step * r);
    if (share > UNKNOWN) {
      known = false;
      continue;
    }
    off = fmax(off, (known ? share : 1) / (1 - share) * R_at(profile, r));
    known = true;
    const double near = error_at(profile, radii.least_mm, r), lost = watts * off;
    if (lost < M) {
      stated = fmin(stated, near + lost * (1 + near + sum->tolerance) / (M - lost));
    }
  }
  return stated;
}

double core_gather_error(const core_gather_sum *sum, const core_gather_points *points,
                         size_t channel, const core_gather_visits *visits) {
  const core_profile *profile = &sum->profile[channel];
  const double least = visits->nearest_mm[channel] * (1 - 0x1p-40) - 0x1p-40 * points->reach_mm;
  const core_radii_range radii = {least > CORE_RADIUS_SMALL_MM ? least : 0, visits->farthest_mm};
  if (visits->queries == 0 || radii.least_mm > radii.most_mm) {
    return 0; /* no sums, or no light */
  }
  const bool narrow = profile->evaluator != CORE_EVALUATOR_F64;
  return error_of_sums(sum, profile, radii, points->node_power[channel], visits->dimmest[channel]) +
         (narrow ? rounding_error(profile, radii.most_mm) : 0) + 0x1p-44;
}

double core_gather_model_error(const core_model_errors *errors, const core_medium *medium) {
  const double mfp_mm = 1 / core_sigma_t_prime(medium);
  const core_radii_range usual = {0.01 * mfp_mm, 20 * mfp_mm};
  return core_model_errors_of(errors, medium, CORE_QUANTITY_R, usual);
}
