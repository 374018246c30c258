/* Gathers: finds the nodes that stand for their points, for each cell of queries, and sums.
 *
 * Queries in one cell share a list of nodes and of leaves whose points are summed one by one. The
 * list's error is below a share of the tolerance, by an estimate of M. A query whose own M shows that
 * the tolerance is missed takes the next list, which is finer. So a query's values depend on its cell
 * and itself.
 */
#include <assert.h>
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/gather/bounds.h"
#include "core/gather/loops.h"
#include "core/gather/points.h"
#include "core/kernels.h"

/* ---- sums ------------------------------------------------------------------------------------ */

#define DECLARE(level, unused) extern const gather_loops gather_loops_##level;
CORE_ISA_LEVELS(DECLARE, )

static const gather_loops *const levels[] = {
#define LEVEL(level, unused) &gather_loops_##level,
    CORE_ISA_LEVELS(LEVEL, )};

struct core_gather_sum {
  const gather_loops *loops;
  size_t channels;
  double tolerance;
  core_profile profile[CORE_GATHER_CHANNELS_MAX]; /* copies that share the caller's memory */
  gather_bounds *bounds;                          /* [channels], NULL if the tolerance is 0 */
};

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
  made->loops = levels[isa->index];
  made->channels = channels;
  made->tolerance = tolerance;
  made->bounds = bounds;
  for (size_t c = 0; c < channels; c++) {
    assert(profiles[c]->evaluator == profiles[0]->evaluator);
    made->profile[c] = *profiles[c];
    if (!plain && !gather_bounds_prepare(&bounds[c], profiles[c])) {
      core_gather_sum_free(made);
      return (core_fault){"model", "a tolerance of 0 with a table that was downloaded", c};
    }
  }
  *sum = made;
  return (core_fault){0};
}

void core_gather_sum_free(core_gather_sum *sum) {
  if (sum != NULL) {
    free(sum->bounds);
    free(sum);
  }
}

size_t core_gather_sum_bytes(const core_gather_sum *sum) {
  return sizeof *sum + (sum->bounds != NULL ? sum->channels * sizeof *sum->bounds : 0);
}

double core_gather_query_cost(const core_gather_sum *sum, const core_gather_points *points) {
  double evaluations = (double)points->n;
  if (sum->tolerance > 0) {
    /* Measured: some hundreds of nodes and points for each tenfold of points at 1e-2 */
    const double finer = sqrt(0.01 / sum->tolerance);
    evaluations = fmin(evaluations, 200 * log2((double)points->n + 2) * fmax(finer, 0.5));
  }
  double cost = 2;
  for (size_t c = 0; c < sum->channels; c++) {
    cost += core_radius_cost(&sum->profile[c], CORE_QUANTITY_R);
  }
  return cost * evaluations;
}

/* ---- scratch --------------------------------------------------------------------------------- */

/* A list that would be longer is replaced by all points. */
enum { LIST_MAX = 1 << 16, QUERIES = 64 };

/* The largest ratio of radius and distance of nodes that the estimate of M takes. */
#define ESTIMATE_ANGLE 0.5

/* The lists of a cell get finer; from ALL_POINTS on, all points are summed. */
enum { ALL_POINTS = 8 };

struct core_gather_scratch {
  /* The list of a cell */
  gather_cell cell;
  int fineness;
  double estimate[CORE_GATHER_CHANNELS_MAX]; /* about M in the cell */
  double error[CORE_GATHER_CHANNELS_MAX];    /* of the whole list */
  size_t node_count, leaf_count;
  uint32_t node[LIST_MAX];
  uint32_t leaf[LIST_MAX];
  double node_error[LIST_MAX][CORE_GATHER_CHANNELS_MAX];
  /* What is evaluated together */
  gather_rows rows;
  gather_pairs pairs;
  _Alignas(64) double at[3][GATHER_POINTS + GATHER_LANES];
  double power[CORE_GATHER_CHANNELS_MAX][GATHER_POINTS + GATHER_LANES];
  double r[GATHER_POINTS];
  double R[2][GATHER_POINTS + GATHER_LANES];
  float narrow_r[GATHER_POINTS];
  float narrow_R[GATHER_POINTS];
  double added[QUERIES][CORE_GATHER_CHANNELS_MAX];
  double lost[QUERIES][CORE_GATHER_CHANNELS_MAX]; /* by rounding, for each sum */
};

core_gather_scratch *core_gather_scratch_create(const core_gather_points *points) {
  assert(points->build == NULL);
  return aligned_alloc(64, sizeof(core_gather_scratch));
}

void core_gather_scratch_free(core_gather_scratch *scratch) {
  free(scratch);
}

size_t core_gather_scratch_bytes(const core_gather_points *points) {
  (void)points;
  return sizeof(core_gather_scratch);
}

/* ---- the list of a cell ---------------------------------------------------------------------- */

typedef struct walk {
  const core_gather_sum *sum;
  const core_gather_points *points;
  core_gather_scratch *s;
  core_gather_visits *visits;
} walk;

/* Sets the errors of a node, by channel, for all queries of the cell. */
static void find_error(const walk *w, uint32_t node, double *error) {
  const core_gather_points *points = w->points;
  const gather_cell *cell = &w->s->cell;
  const double *power = &points->node_power[node * points->channels];
  /* Rounding of centroids */
  const double least_distance = points->reach_mm * 0x1p-41 / w->sum->tolerance;
  w->visits->tested++;
  for (size_t group = 0; group < points->groups; group++) {
    const gather_moments *m = &points->moments[node * points->groups + group];
    const double x = cell->at[0] - m->at[0], y = cell->at[1] - m->at[1], z = cell->at[2] - m->at[2];
    const double distance = sqrt(x * x + y * y + z * z);
    const double least = (distance - cell->radius_mm) * (1 - 0x1p-40);
    const double most = (distance + cell->radius_mm) * (1 + 0x1p-40);
    const double nearest = least - m->radius_mm;
    const double ratio = m->radius_mm / least;
    const bool apart = least > 0 && ratio <= GATHER_SPREAD_MAX;
    const bool rounded = m->radius_mm > 0 && nearest < least_distance;
    const double quartic = ratio * ratio * ratio * ratio;
    const double cubic =
        m->fourth * (12 * most * most + 6 * most * m->radius_mm + m->radius_mm * m->radius_mm);
    const size_t spread = apart ? (size_t)(ratio * 8 * (1 - 0x1p-40)) : 0;
    for (size_t c = 0; c < points->channels; c++) {
      if (points->group[c] != group) {
        continue;
      }
      const gather_bounds *bounds = &w->sum->bounds[c];
      double each = gather_top(bounds, nearest > 0 ? nearest : 0);
      if (apart && least >= bounds->least_mm && most < bounds->most_mm) {
        const size_t last = gather_band(bounds, most);
        double by_quartic = 0, by_cubic = 0;
        for (size_t band = gather_band(bounds, least); band <= last; band++) {
          const gather_bound *near = &bounds->near[band][spread];
          by_quartic = near->quartic > by_quartic ? near->quartic : by_quartic;
          by_cubic = near->cubic > by_cubic ? near->cubic : by_cubic;
        }
        const double smooth = by_quartic * quartic + by_cubic * cubic;
        each = smooth < each ? smooth : each;
      }
      each = rounded && each > 0 ? (double)INFINITY : each;
      error[c] = power[c] > 0 && each > 0 ? power[c] * each : 0;
    }
  }
}

/* Replaces the node at a place of the list by its children, or moves it to the leaves. Returns false
 * if the list is full. */
static bool open_node(const walk *w, size_t place) {
  core_gather_scratch *s = w->s;
  const uint32_t at = s->node[place];
  const gather_node *node = &w->points->nodes[at];
  if (node->children == 0) {
    if (s->leaf_count == LIST_MAX) {
      return false;
    }
    s->leaf[s->leaf_count++] = at;
    s->node_count--;
    s->node[place] = s->node[s->node_count];
    memcpy(s->node_error[place], s->node_error[s->node_count], sizeof s->node_error[place]);
    return true;
  }
  if (s->node_count + node->children > LIST_MAX) {
    return false;
  }
  for (uint32_t i = 0; i < node->children; i++) {
    const size_t to = i == 0 ? place : s->node_count++;
    s->node[to] = node->child + i;
    find_error(w, node->child + i, s->node_error[to]);
  }
  return true;
}

/* Starts the list with the root, and estimates M by nodes that look smaller than an angle. Returns
 * false if there are too many of these. */
static bool start_list(const walk *w) {
  core_gather_scratch *s = w->s;
  const core_gather_points *points = w->points;
  memset(s->estimate, 0, sizeof s->estimate);
  s->node_count = 1;
  s->node[0] = 0;
  while (s->node_count > 0) {
    const uint32_t at = s->node[--s->node_count];
    const gather_node *node = &points->nodes[at];
    const gather_moments *m = &points->moments[at * points->groups];
    const double x = s->cell.at[0] - m->at[0], y = s->cell.at[1] - m->at[1],
                 z = s->cell.at[2] - m->at[2];
    const double distance = sqrt(x * x + y * y + z * z);
    if (node->children > 0 && m->radius_mm > ESTIMATE_ANGLE * distance) {
      for (uint32_t i = 0; i < node->children; i++) {
        s->node[s->node_count++] = node->child + i;
      }
      if (s->node_count + 8 > LIST_MAX) {
        return false;
      }
      continue;
    }
    const double r = fmax(distance, 0.5 * fmax(m->radius_mm, s->cell.radius_mm));
    for (size_t c = 0; c < points->channels; c++) {
      s->estimate[c] +=
          points->node_power[at * points->channels + c] * gather_about(&w->sum->bounds[c], r);
    }
  }
  s->leaf_count = 0;
  s->node_count = 1;
  s->node[0] = 0;
  find_error(w, 0, s->node_error[0]);
  return true;
}

static void add_errors(const walk *w) {
  core_gather_scratch *s = w->s;
  memset(s->error, 0, sizeof s->error);
  for (size_t i = 0; i < s->node_count; i++) {
    for (size_t c = 0; c < w->points->channels; c++) {
      s->error[c] += s->node_error[i][c];
    }
  }
}

/* Opens nodes of the list until its errors are within a share of what the tolerance allows. */
static bool refine(const walk *w, double share) {
  core_gather_scratch *s = w->s;
  const size_t channels = w->points->channels;
  double limit[CORE_GATHER_CHANNELS_MAX], budget[CORE_GATHER_CHANNELS_MAX];
  for (size_t c = 0; c < channels; c++) {
    budget[c] = share * w->sum->tolerance * s->estimate[c];
    limit[c] = budget[c] / 16;
  }
  for (int round = 0; round < 200; round++) {
    for (size_t i = 0; i < s->node_count;) {
      bool fails = false;
      for (size_t c = 0; c < channels; c++) {
        fails = fails || s->node_error[i][c] > limit[c];
      }
      if (!fails) {
        i++;
      } else if (!open_node(w, i)) {
        return false;
      }
    }
    add_errors(w);
    bool within = true;
    for (size_t c = 0; c < channels; c++) {
      if (s->error[c] > budget[c]) {
        const double by = 0.7 * budget[c] / s->error[c];
        limit[c] *= by < 0.125 ? 0.125 : by;
        within = false;
      }
    }
    if (within) {
      return true;
    }
  }
  return false;
}

/* Makes the next list of the cell. */
static void make_finer(const walk *w) {
  core_gather_scratch *s = w->s;
  s->fineness++;
  bool made = s->fineness < ALL_POINTS;
  if (made && s->fineness == 0) {
    made = start_list(w);
  }
  if (!made || !refine(w, 0.7 * ldexp(1, -2 * s->fineness))) {
    s->fineness = ALL_POINTS;
    s->node_count = 0;
    s->leaf_count = 1;
    memset(s->error, 0, sizeof s->error);
  }
}

/* ---- summing --------------------------------------------------------------------------------- */

/* Adds without losing what rounding takes (Neumaier 1974). */
static void add(double *sum, double *lost, double value) {
  const double more = *sum + value;
  if (more < (double)INFINITY) {
    *lost += fabs(*sum) >= fabs(value) ? (*sum - more) + value : (value - more) + *sum;
  }
  *sum = more;
}

/* Sets out to R at n radii, a multiple of GATHER_LANES. */
static void evaluate(const core_gather_sum *sum, size_t channel, core_gather_scratch *s, size_t n,
                     const double *r, double *out) {
  const core_profile *profile = &sum->profile[channel];
  if (profile->evaluator == CORE_EVALUATOR_F64) {
    core_eval_f64(profile, CORE_QUANTITY_R, n, r, out);
    return;
  }
  sum->loops->narrow(n, r, s->narrow_r);
  core_eval_f32(profile, CORE_QUANTITY_R, n, s->narrow_r, s->narrow_R);
  sum->loops->widen(n, s->narrow_R, out);
}

static size_t padded(size_t n) {
  return (n + GATHER_LANES - 1) / GATHER_LANES * GATHER_LANES;
}

/* How often each number of gather_moments occurs. */
static const double times[GATHER_FIELDS] = {1, 1, 1, 1, 1, 1, 1, 1, 2, 2, 2,
                                            1, 1, 1, 3, 3, 3, 3, 3, 3, 6};
_Static_assert(sizeof(gather_moments) == GATHER_FIELDS * sizeof(double), "all of them");

/* Copies the moments of some nodes of the list to the rows, and the powers of the group's channels.
 * Returns the number of rows. The last rows are further ones without power. */
static size_t fill_rows(const walk *w, size_t group, size_t first, size_t count) {
  const core_gather_points *points = w->points;
  const size_t n = padded(count);
  for (size_t i = 0; i < n; i += GATHER_LANES) {
    double moments[GATHER_LANES][GATHER_FIELDS];
    for (size_t k = 0; k < GATHER_LANES; k++) {
      const size_t place = i + k < count ? i + k : count - 1;
      const size_t node = w->s->node[first + place];
      memcpy(moments[k], &points->moments[node * points->groups + group], sizeof moments[k]);
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

/* Adds the nodes of the list to the sums of the queries at xyz[order[0]], ... */
static void add_nodes(const walk *w, size_t queries, const uint32_t *order, const double *xyz) {
  core_gather_scratch *s = w->s;
  const gather_loops *loops = w->sum->loops;
  for (size_t first = 0; first < s->node_count; first += GATHER_NODES) {
    const size_t rest = s->node_count - first;
    const size_t count = rest < GATHER_NODES ? rest : GATHER_NODES;
    for (size_t group = 0; group < w->points->groups; group++) {
      const size_t n = fill_rows(w, group, first, count);
      for (size_t q = 0; q < queries; q++) {
        loops->pair(n, &s->rows, &xyz[3 * (size_t)order[q]], &s->pairs);
        for (size_t c = 0; c < w->points->channels; c++) {
          if (w->points->group[c] == group) {
            evaluate(w->sum, c, s, n, s->pairs.r[0], s->R[0]);
            evaluate(w->sum, c, s, n, s->pairs.r[1], s->R[1]);
            add(&s->added[q][c], &s->lost[q][c],
                loops->sum_pairs(n, s->power[c], s->pairs.share, s->R[0], s->R[1]));
          }
        }
      }
    }
  }
  w->visits->nodes += (uint64_t)queries * s->node_count;
}

/* Adds `count` points that were copied. */
static void add_copied(const walk *w, size_t count, size_t queries, const uint32_t *order,
                       const double *xyz) {
  core_gather_scratch *s = w->s;
  const gather_loops *loops = w->sum->loops;
  const size_t n = padded(count);
  for (size_t i = count; i < n; i++) {
    for (int k = 0; k < 3; k++) {
      s->at[k][i] = s->at[k][count - 1];
    }
    for (size_t c = 0; c < w->points->channels; c++) {
      s->power[c][i] = 0;
    }
  }
  for (size_t q = 0; q < queries; q++) {
    loops->distances(n, s->at[0], s->at[1], s->at[2], &xyz[3 * (size_t)order[q]], s->r);
    for (size_t c = 0; c < w->points->channels; c++) {
      evaluate(w->sum, c, s, n, s->r, s->R[0]);
      add(&s->added[q][c], &s->lost[q][c], loops->sum(n, s->power[c], s->R[0]));
    }
  }
  w->visits->points += (uint64_t)queries * count;
}

/* Adds the points of the leaves, or all points. */
static void add_points(const walk *w, size_t queries, const uint32_t *order, const double *xyz) {
  core_gather_scratch *s = w->s;
  const core_gather_points *points = w->points;
  const gather_node all = {.first = 0, .count = (uint32_t)points->n};
  size_t filled = 0;
  for (size_t i = 0; i < s->leaf_count; i++) {
    const gather_node *leaf = s->fineness == ALL_POINTS ? &all : &points->nodes[s->leaf[i]];
    for (size_t done = 0; done < leaf->count;) {
      const size_t rest = leaf->count - done, room = GATHER_POINTS - filled;
      const size_t count = rest < room ? rest : room;
      for (int k = 0; k < 3; k++) {
        memcpy(&s->at[k][filled], &points->at[k][leaf->first + done], count * sizeof s->at[0][0]);
      }
      for (size_t c = 0; c < points->channels; c++) {
        w->sum->loops->widen(count, &points->power[c][leaf->first + done], &s->power[c][filled]);
      }
      done += count;
      filled += count;
      if (filled == GATHER_POINTS) {
        add_copied(w, filled, queries, order, xyz);
        filled = 0;
      }
    }
  }
  if (filled > 0) {
    add_copied(w, filled, queries, order, xyz);
  }
}

/* Whether M is within the tolerance in each channel; sets the bounds. */
static bool finish_query(const walk *w, size_t q, double *M, float *bound) {
  const core_gather_scratch *s = w->s;
  bool within = true;
  for (size_t c = 0; c < w->points->channels; c++) {
    const double value = s->added[q][c] + s->lost[q][c];
    const double spare = s->node_count > 0 ? w->sum->tolerance * 0x1p-8 + w->points->uneven[c] : 0;
    const double error = s->error[c] > 0 ? s->error[c] / (value - s->error[c]) : 0;
    within = within && value >= s->error[c] && error + spare <= w->sum->tolerance;
    M[c] = value;
    if (bound != NULL) {
      bound[c] = (float)((error + spare) * (1 - 0x1p-22)); /* `spare` is more than this */
    }
  }
  return within || s->fineness == ALL_POINTS;
}

/* Gathers at queries of one cell. */
static void gather_cell_queries(const walk *w, size_t queries, uint32_t *order, const double *xyz,
                                double *M, float *bound) {
  core_gather_scratch *s = w->s;
  const size_t channels = w->points->channels;
  for (;;) {
    memset(s->added, 0, sizeof s->added);
    memset(s->lost, 0, sizeof s->lost);
    add_nodes(w, queries, order, xyz);
    add_points(w, queries, order, xyz);
    size_t left = 0;
    for (size_t q = 0; q < queries; q++) {
      const size_t at = order[q] * channels;
      if (!finish_query(w, q, M + at, bound != NULL ? bound + at : NULL)) {
        order[left++] = order[q];
      }
    }
    if (left == 0) {
      return;
    }
    queries = left;
    make_finer(w);
  }
}

static bool same_cell(const gather_cell *a, const gather_cell *b) {
  return memcmp(a, b, sizeof *a) == 0;
}

void core_gather(const core_gather_sum *sum, const core_gather_points *points,
                 core_gather_scratch *scratch, size_t n, const uint32_t *order, const double *xyz,
                 double *M, float *bound, core_gather_visits *visits) {
  assert(points->build == NULL && points->channels == sum->channels);
  const walk w = {sum, points, scratch, visits};
  const bool plain = !(sum->tolerance > 0);
  bool known = false;
  for (size_t done = 0; done < n;) {
    uint32_t batch[QUERIES];
    gather_cell cell = {{0, 0, 0}, 0};
    size_t count = 0;
    for (; count < QUERIES && done + count < n; count++) {
      const uint32_t q = order != NULL ? order[done + count] : (uint32_t)(done + count);
      const gather_cell own = plain ? cell : gather_cell_of(points, &xyz[3 * (size_t)q]);
      if (count > 0 && !same_cell(&own, &cell)) {
        break;
      }
      cell = own;
      batch[count] = q;
    }
    if (plain) {
      scratch->fineness = ALL_POINTS - 1;
      make_finer(&w);
    } else if (!known || !same_cell(&cell, &scratch->cell) || scratch->fineness > 0) {
      scratch->cell = cell;
      scratch->fineness = -1;
      make_finer(&w);
    }
    known = true;
    gather_cell_queries(&w, count, batch, xyz, M, bound);
    done += count;
  }
  visits->queries += n;
}

/* ---- errors ---------------------------------------------------------------------------------- */

/* Rounding a distance to single precision changes R by this much, relative, at distances up to
 * most_mm where R has not underflowed. */
static double rounding_error(const core_profile *profile, double most_mm) {
  double steepest = 1;
  for (double r = 1e-4 * profile->scale_mm; r < 1.05 * most_mm; r *= 1.05) {
    const double far = r < most_mm ? r : most_mm;
    const float radii[2] = {(float)(0.99 * far), (float)far};
    float R[2];
    core_eval_f32(profile, CORE_QUANTITY_R, 2, radii, R);
    if (R[1] > FLT_MIN && R[0] <= FLT_MAX) {
      steepest = fmax(steepest, 100 * ((double)R[0] / (double)R[1] - 1)); /* at least the slope */
    }
  }
  return 1.1 * steepest * 0x1p-24;
}

double core_gather_error(const core_gather_sum *sum, const core_gather_points *points,
                         size_t channel, size_t n, const double *xyz) {
  double most = 0;
  for (size_t i = 0; i < n; i++) {
    double square = 0;
    for (size_t k = 0; k < 3; k++) {
      const double x = xyz[3 * i + k];
      const double far = fmax(fabs(x - points->least[k]), fabs(x - points->most[k]));
      square += far * far;
    }
    most = fmax(most, square);
  }
  const core_profile *profile = &sum->profile[channel];
  const core_radii_range radii = {0, sqrt(most)};
  const core_stated_errors errors = core_profile_errors(profile, CORE_QUANTITY_R, radii);
  const bool narrow = profile->evaluator != CORE_EVALUATOR_F64;
  return errors.numerical + errors.numerical_per_mm * radii.most_mm +
         (narrow ? rounding_error(profile, radii.most_mm) : 0) + 0x1p-44;
}
