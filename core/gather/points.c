/* Checks points and queries, and builds sets of points: sorts the points by Morton codes (Morton
 * 1966), makes the nodes from the root down, and computes their moments from the leaves up. */
#include <assert.h>
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/gather/points.h"

/* ---- checking -------------------------------------------------------------------------------- */

static core_fault check_coordinates(const char *field, size_t n, const double *xyz) {
  for (size_t i = 0; i < 3 * n; i++) {
    if (!(fabs(xyz[i]) <= CORE_GATHER_MOST_MM)) {
      return (core_fault){field, "coordinates from -1e9 to 1e9 mm", i / 3};
    }
  }
  return (core_fault){0};
}

core_fault core_gather_check_points(size_t n, const double *xyz, size_t channels,
                                    const float *power) {
  const core_fault fault = check_coordinates("points", n, xyz);
  for (size_t i = 0; i < channels * n && fault.field == NULL; i++) {
    if (!(power[i] >= 0 && power[i] <= (float)CORE_GATHER_MOST_POWER)) {
      return (core_fault){"power", "0 to 1e30", i / channels};
    }
  }
  return fault;
}

core_fault core_gather_check_queries(size_t n, const double *xyz) {
  return check_coordinates("queries", n, xyz);
}

/* ---- the state of building ------------------------------------------------------------------- */

enum {
  KEY_BITS = 21, /* bits of the key for each coordinate */
  DIGIT_BITS = 11,
  DIGITS = (3 * KEY_BITS + DIGIT_BITS - 1) / DIGIT_BITS,
  BINS = 1 << DIGIT_BITS
};

/* The phases of construction. A part of the points, at first all of them, gets a bounding box and
 * Morton keys and is sorted; then its nodes are made. Points with equal keys that are too many for
 * a leaf become a new part. After the last part, channels are grouped and moments computed. */
enum phase { BOX, KEYS, COUNT, MOVE, NODES, COLLECT, GROUPS, MOMENTS, PHASES };

/* The time of one item of each phase in ns. An item is a point, a node or a pair of channels. */
static const double phase_ns[PHASES] = {
    [BOX] = 6,     [KEYS] = 12,    [COUNT] = 2,    [MOVE] = 8,
    [NODES] = 100, [COLLECT] = 20, [GROUPS] = 1e6, [MOMENTS] = 500};

struct gather_build {
  const double *xyz; /* the caller's */
  const float *power;
  uint64_t *keys[2];
  uint32_t *index[2];
  enum phase phase;
  size_t at;         /* the next item of the phase */
  size_t begin, end; /* the part that is being sorted */
  double least[3], most[3];
  double corner[3]; /* the part's cube */
  double edge_mm;
  size_t node; /* next node that gets its children */
  size_t head; /* the node whose points are the part */
  size_t tail; /* the number of nodes before those of the part */
  int digit;
  uint32_t bins[BINS];
  size_t pair[2];       /* of channels */
  size_t node_capacity; /* number of nodes that the array can hold */
};

/* Returns the capacity of the array of nodes. A node that is not a leaf has at least two children,
 * so there are fewer nodes than twice the number of leaves. When the array is full, further leaves
 * hold more than GATHER_LEAF points. For n < 32, at most n - GATHER_LEAF nodes are divided, with 8
 * children each. */
static size_t node_capacity(size_t n) {
  return n < 32 ? 2 * n : n / 3 + 64;
}

static size_t node_bytes(size_t channels, size_t groups) {
  return sizeof(gather_node) + groups * sizeof(gather_moments) + channels * sizeof(double);
}

static size_t point_bytes(size_t channels) {
  return 3 * sizeof(double) + channels * sizeof(float);
}

size_t core_gather_points_bytes(const core_gather_points *points) {
  return sizeof *points + points->n * point_bytes(points->channels) +
         points->node_count * node_bytes(points->channels, points->groups);
}

size_t core_gather_points_channels(const core_gather_points *points) {
  return points->channels;
}

static void free_build(gather_build *build) {
  if (build != NULL) {
    free(build->keys[0]);
    free(build->index[0]);
    free(build);
  }
}

void core_gather_points_free(core_gather_points *points) {
  if (points != NULL) {
    free_build(points->build);
    free(points->at[0]);
    free(points->power[0]);
    free(points->nodes);
    free(points->moments);
    free(points->node_power);
    free(points);
  }
}

core_gather_points *core_gather_points_create(size_t n, const double *xyz, size_t channels,
                                              const float *power) {
  assert(n >= 1 && n <= CORE_GATHER_POINTS_MAX);
  assert(channels >= 1 && channels <= CORE_GATHER_CHANNELS_MAX);
  core_gather_points *points = calloc(1, sizeof *points);
  if (points == NULL) {
    return NULL;
  }
  const size_t nodes = node_capacity(n);
  points->n = n;
  points->channels = channels;
  points->at[0] = malloc(3 * n * sizeof(double));
  points->power[0] = malloc(channels * n * sizeof(float));
  points->nodes = malloc(nodes * sizeof *points->nodes);
  points->node_count = 1;
  points->moments = malloc(nodes * channels * sizeof *points->moments);
  points->node_power = malloc(nodes * channels * sizeof *points->node_power);
  gather_build *build = points->build = calloc(1, sizeof *points->build);
  if (build != NULL) {
    build->keys[0] = malloc(2 * n * sizeof *build->keys[0]);
    build->index[0] = malloc(2 * n * sizeof *build->index[0]);
  }
  if (points->at[0] == NULL || points->power[0] == NULL || points->nodes == NULL ||
      points->moments == NULL || points->node_power == NULL || build == NULL ||
      build->keys[0] == NULL || build->index[0] == NULL) {
    core_gather_points_free(points);
    return NULL;
  }
  for (size_t k = 1; k < 3; k++) {
    points->at[k] = points->at[0] + k * n;
  }
  for (size_t c = 1; c < channels; c++) {
    points->power[c] = points->power[0] + c * n;
  }
  build->xyz = xyz;
  build->power = power;
  build->keys[1] = build->keys[0] + n;
  build->index[1] = build->index[0] + n;
  build->end = n;
  build->tail = 1;
  points->nodes[0] = (gather_node){.count = (uint32_t)n};
  build->node_capacity = nodes;
  for (size_t i = 0; i < n; i++) {
    build->index[0][i] = (uint32_t)i;
  }
  return points;
}

/* ---- sorting --------------------------------------------------------------------------------- */

static const double *coordinates(const gather_build *b, size_t i) {
  return b->xyz + 3 * (size_t)b->index[0][i];
}

/* Extends the part's bounding box by its next `count` points. */
static void box(gather_build *b, size_t count) {
  if (b->at == 0) {
    memcpy(b->least, coordinates(b, b->begin), sizeof b->least);
    memcpy(b->most, coordinates(b, b->begin), sizeof b->most);
  }
  for (size_t i = b->begin + b->at; i < b->begin + b->at + count; i++) {
    const double *x = coordinates(b, i);
    for (size_t k = 0; k < 3; k++) {
      b->least[k] = fmin(b->least[k], x[k]);
      b->most[k] = fmax(b->most[k], x[k]);
    }
  }
}

/* Parts with a smaller extent are not divided. */
#define EXTENT_MIN_MM 1e-280

/* Sets the part's cube: it contains the bounding box, and its edge is a power of two. */
static void set_cube(gather_build *b) {
  double extent = 0;
  for (size_t k = 0; k < 3; k++) {
    extent = fmax(extent, b->most[k] - b->least[k]);
  }
  int exponent;
  frexp(extent, &exponent);
  b->edge_mm = extent > EXTENT_MIN_MM ? ldexp(1, exponent) : 0;
  for (size_t k = 0; k < 3; k++) {
    const double middle = 0.5 * (b->least[k] + b->most[k]);
    b->corner[k] = fmin(middle - 0.5 * b->edge_mm, b->least[k]);
  }
}

/* Inserts two zero bits before each of the 21 low bits: one coordinate of a Morton code. */
static uint64_t spread_bits(uint64_t x) {
  x = (x | x << 32) & UINT64_C(0x1f00000000ffff);
  x = (x | x << 16) & UINT64_C(0x1f0000ff0000ff);
  x = (x | x << 8) & UINT64_C(0x100f00f00f00f00f);
  x = (x | x << 4) & UINT64_C(0x10c30c30c30c30c3);
  return (x | x << 2) & UINT64_C(0x1249249249249249);
}

static uint64_t compact_bits(uint64_t x) {
  x &= UINT64_C(0x1249249249249249);
  x = (x | x >> 2) & UINT64_C(0x10c30c30c30c30c3);
  x = (x | x >> 4) & UINT64_C(0x100f00f00f00f00f);
  x = (x | x >> 8) & UINT64_C(0x1f0000ff0000ff);
  x = (x | x >> 16) & UINT64_C(0x1f00000000ffff);
  return (x | x >> 32) & 0x1fffff;
}

static uint64_t morton(const double x[3], const double corner[3], double per_mm) {
  uint64_t key = 0;
  for (size_t k = 0; k < 3; k++) {
    const double at = (x[k] - corner[k]) * per_mm;
    const double most = (1 << KEY_BITS) - 1;
    key |= spread_bits((uint64_t)(at < 0 ? 0 : at > most ? most : at)) << k;
  }
  return key;
}

static double keys_per_mm(double edge_mm) {
  return edge_mm > 0 ? (1 << KEY_BITS) / edge_mm : 0;
}

static void make_keys(gather_build *b, size_t count) {
  const double per_mm = keys_per_mm(b->edge_mm);
  for (size_t i = b->begin + b->at; i < b->begin + b->at + count; i++) {
    b->keys[0][i] = morton(coordinates(b, i), b->corner, per_mm);
  }
}

static size_t digit_of(const gather_build *b, uint64_t key) {
  return key >> (b->digit * DIGIT_BITS) & (BINS - 1);
}

static void count_digits(gather_build *b, size_t count) {
  if (b->at == 0) {
    memset(b->bins, 0, sizeof b->bins);
  }
  for (size_t i = b->begin + b->at; i < b->begin + b->at + count; i++) {
    b->bins[digit_of(b, b->keys[0][i])]++;
  }
}

/* Replaces the number of keys with each digit by the position of the first such key (radix
 * sort). */
static void start_moving(gather_build *b) {
  uint32_t at = (uint32_t)b->begin;
  for (size_t i = 0; i < BINS; i++) {
    const uint32_t count = b->bins[i];
    b->bins[i] = at;
    at += count;
  }
}

static void move_digits(gather_build *b, size_t count) {
  for (size_t i = b->begin + b->at; i < b->begin + b->at + count; i++) {
    const uint64_t key = b->keys[0][i];
    const uint32_t to = b->bins[digit_of(b, key)]++;
    b->keys[1][to] = key;
    b->index[1][to] = b->index[0][i];
  }
}

static void end_moving(gather_build *b) {
  const size_t count = b->end - b->begin;
  memcpy(b->keys[0] + b->begin, b->keys[1] + b->begin, count * sizeof *b->keys[0]);
  memcpy(b->index[0] + b->begin, b->index[1] + b->begin, count * sizeof *b->index[0]);
}

/* ---- nodes ----------------------------------------------------------------------------------- */

/* Returns the first position in [from, to) whose key is at least `key`, or `to` if there is
 * none. */
static size_t first_with(const gather_build *b, size_t from, size_t to, uint64_t key) {
  while (from < to) {
    const size_t middle = from + (to - from) / 2;
    if (b->keys[0][middle] < key) {
      from = middle + 1;
    } else {
      to = middle;
    }
  }
  return from;
}

/* Sets the corner and edge of a node's cube. The edge is the part's edge times 2^-level; the corner
 * is decoded from the key. */
static void set_corner(const gather_build *b, gather_node *node, uint64_t key, int level) {
  node->edge_mm = ldexp(b->edge_mm, -level);
  for (size_t k = 0; k < 3; k++) {
    const uint64_t at = compact_bits(key >> k) >> (KEY_BITS - level);
    node->corner[k] = b->corner[k] + (double)at * node->edge_mm;
  }
}

/* The value of `children` that marks a leaf whose points share a key, until they are sorted as a
 * part. */
#define UNSORTED UINT32_MAX

/* Makes the children of the node b->node and moves on to the next node. */
static void make_children(core_gather_points *points) {
  gather_build *b = points->build;
  gather_node *node = &points->nodes[b->node];
  const size_t first = node->first, end = first + node->count;
  const uint64_t differ = b->keys[0][first] ^ b->keys[0][end - 1];
  node->child = 0;
  if (node->count <= GATHER_LEAF || points->node_count + 8 > b->node_capacity) {
    return;
  }
  if (differ == 0) {
    node->child = b->edge_mm > 0 ? UNSORTED : 0;
    return;
  }
  int bits = 3;
  while (differ >> bits != 0) {
    bits += 3;
  }
  const int level = KEY_BITS - bits / 3; /* the deepest level at which all keys are in one cube */
  set_corner(b, node, b->keys[0][first], level);
  node->child = (uint32_t)points->node_count;
  const int shift = bits - 3;
  for (size_t from = first; from < end;) {
    const size_t to = first_with(b, from, end, ((b->keys[0][from] >> shift) + 1) << shift);
    gather_node *child = &points->nodes[points->node_count++];
    *child = (gather_node){.first = (uint32_t)from, .count = (uint32_t)(to - from)};
    set_corner(b, child, b->keys[0][from], level + 1);
    node->children++;
    from = to;
  }
}

/* Begins the next part. Returns false if there is none. */
static bool next_part(core_gather_points *points) {
  gather_build *b = points->build;
  while (b->head < points->node_count && points->nodes[b->head].child != UNSORTED) {
    b->head++;
  }
  if (b->head == points->node_count) {
    return false;
  }
  b->begin = points->nodes[b->head].first;
  b->end = b->begin + points->nodes[b->head].count;
  b->node = b->head;
  b->tail = points->node_count;
  return true;
}

/* Copies the next `count` points into the order of the tree. */
static void collect(core_gather_points *points, size_t count) {
  const gather_build *b = points->build;
  for (size_t i = b->at; i < b->at + count; i++) {
    const size_t from = b->index[0][i];
    for (size_t k = 0; k < 3; k++) {
      points->at[k][i] = b->xyz[3 * from + k];
    }
    for (size_t c = 0; c < points->channels; c++) {
      points->power[c][i] = b->power[points->channels * from + c];
    }
  }
}

/* ---- groups of channels ---------------------------------------------------------------------- */

/* Two channels share moments if their powers are proportional up to this relative difference.
 * Powers in single precision that are products with the same factors differ by less. */
#define UNEVEN_MOST 0x1p-22

/* Returns the largest relative deviation of one channel's powers from a multiple of the other's.
 * INFINITY if it is above UNEVEN_MOST. */
static double deviation(const core_gather_points *points, const float *one, const float *other) {
  size_t brightest = 0;
  for (size_t i = 1; i < points->n; i++) {
    brightest = one[i] > one[brightest] ? i : brightest;
  }
  const double ratio = one[brightest] > 0 ? (double)other[brightest] / (double)one[brightest] : 0;
  double most = 0;
  for (size_t i = 0; i < points->n; i++) {
    const double expected = ratio * (double)one[i];
    const double off = fabs((double)other[i] - expected);
    if (!(off <= UNEVEN_MOST * expected)) {
      return (double)INFINITY;
    }
    most = expected > 0 ? fmax(most, off / expected) : most;
  }
  return most;
}

/* Compares the channel pair[0] with the next group: adds the channel to that group if they are
 * proportional. */
static void find_group(core_gather_points *points) {
  gather_build *b = points->build;
  const size_t channel = b->pair[0], other = b->pair[1];
  const bool leads = other < channel && points->uneven[other] <= 0 &&
                     (other == 0 || points->group[other] > points->group[other - 1]);
  if (other == channel) {
    points->group[channel] = points->groups++;
  } else {
    const double off =
        leads ? deviation(points, points->power[other], points->power[channel]) : (double)INFINITY;
    if (off > UNEVEN_MOST) {
      b->pair[1]++;
      return;
    }
    points->group[channel] = points->group[other];
    points->uneven[channel] = 2 * off;
  }
  b->pair[0]++;
  b->pair[1] = 0;
}

/* ---- moments --------------------------------------------------------------------------------- */

enum { XX, YY, ZZ, XY, XZ, YZ };

/* Indices of d_a d_b in `second`, and of d_a d_b d_c in `third`, for a, b and c of x, y, z. */
static const int second_of[3][3] = {{XX, XY, XZ}, {XY, YY, YZ}, {XZ, YZ, ZZ}};
static const int third_of[10][3] = {{0, 0, 0}, {1, 1, 1}, {2, 2, 2}, {0, 0, 1}, {0, 0, 2},
                                    {0, 1, 1}, {1, 1, 2}, {0, 2, 2}, {1, 2, 2}, {0, 1, 2}};

/* Sets trace[3] to the vector E |d|^2 d. */
static void trace_third(const gather_moments *m, double trace[3]) {
  trace[0] = m->third[0] + m->third[5] + m->third[7];
  trace[1] = m->third[3] + m->third[1] + m->third[8];
  trace[2] = m->third[4] + m->third[6] + m->third[2];
}

/* Adds points with the power `weight` and the moments *part to *sum. d: their centroid minus the
 * centroid of the sum. */
static void add_moments(gather_moments *sum, double weight, const gather_moments *part,
                        const double d[3]) {
  const double *c = part->second;
  double trace[3];
  trace_third(part, trace);
  const double d2 = d[0] * d[0] + d[1] * d[1] + d[2] * d[2], spread = c[XX] + c[YY] + c[ZZ];
  double cd[3], td[6] = {0};
  for (int a = 0; a < 3; a++) {
    cd[a] = c[second_of[a][0]] * d[0] + c[second_of[a][1]] * d[1] + c[second_of[a][2]] * d[2];
  }
  for (int i = 0; i < 10; i++) {
    const int x = third_of[i][0], y = third_of[i][1], z = third_of[i][2];
    td[second_of[y][z]] += d[x] * part->third[i];
    td[second_of[x][z]] += x != y ? d[y] * part->third[i] : 0;
    td[second_of[x][y]] += z != y ? d[z] * part->third[i] : 0;
  }
  for (int a = 0; a < 3; a++) {
    for (int b = a; b < 3; b++) {
      const int ab = second_of[a][b];
      sum->fourth[ab] +=
          weight * (part->fourth[ab] + 2 * td[ab] + d2 * c[ab] + d[a] * trace[b] + d[b] * trace[a] +
                    2 * (d[a] * cd[b] + d[b] * cd[a]) + d[a] * d[b] * (spread + d2));
    }
  }
  for (int i = 0; i < 10; i++) {
    const int x = third_of[i][0], y = third_of[i][1], z = third_of[i][2];
    sum->third[i] +=
        weight * (part->third[i] + d[x] * c[second_of[y][z]] + d[y] * c[second_of[x][z]] +
                  d[z] * c[second_of[x][y]] + d[x] * d[y] * d[z]);
  }
  for (int a = 0; a < 3; a++) {
    for (int b = a; b < 3; b++) {
      sum->second[second_of[a][b]] += weight * (c[second_of[a][b]] + d[a] * d[b]);
    }
  }
}

static void divide_moments(gather_moments *sum, double weight) {
  const double by = weight > 0 ? 1 / weight : 0;
  for (int i = 0; i < 6; i++) {
    sum->second[i] *= by;
    sum->fourth[i] *= by;
  }
  for (int i = 0; i < 10; i++) {
    sum->third[i] *= by;
  }
}

static void leaf_moments(const core_gather_points *points, const gather_node *node,
                         const float *power, gather_moments *m) {
  static const gather_moments none = {.radius_mm = 0};
  double weight = 0, from[3] = {0};
  const size_t first = node->first, end = first + node->count;
  const double start[3] = {points->at[0][first], points->at[1][first], points->at[2][first]};
  *m = none;
  for (size_t i = first; i < end; i++) {
    weight += (double)power[i];
    for (int k = 0; k < 3; k++) {
      from[k] += (double)power[i] * (points->at[k][i] - start[k]);
    }
  }
  for (int k = 0; k < 3; k++) {
    m->at[k] = weight > 0 ? start[k] + from[k] / weight : start[k];
  }
  for (size_t i = first; i < end; i++) {
    const double d[3] = {points->at[0][i] - m->at[0], points->at[1][i] - m->at[1],
                         points->at[2][i] - m->at[2]};
    add_moments(m, (double)power[i], &none, d);
  }
  divide_moments(m, weight);
}

static void inner_moments(const core_gather_points *points, const gather_node *node, size_t group,
                          size_t channel, gather_moments *m) {
  double weight = 0, from[3] = {0};
  const gather_moments *part = &points->moments[node->child * points->groups + group];
  const double *power = &points->node_power[node->child * points->channels + channel];
  *m = (gather_moments){.radius_mm = 0};
  for (size_t i = 0; i < node->children; i++) {
    const double share = power[i * points->channels];
    weight += share;
    for (int k = 0; k < 3; k++) {
      from[k] += share * (part[i * points->groups].at[k] - part[0].at[k]);
    }
  }
  for (int k = 0; k < 3; k++) {
    m->at[k] = part[0].at[k] + (weight > 0 ? from[k] / weight : 0);
  }
  for (size_t i = 0; i < node->children; i++) {
    const gather_moments *one = &part[i * points->groups];
    const double d[3] = {one->at[0] - m->at[0], one->at[1] - m->at[1], one->at[2] - m->at[2]};
    add_moments(m, power[i * points->channels], one, d);
    m->radius_mm = fmax(m->radius_mm, gather_distance(one->at, m->at) + one->radius_mm);
  }
  divide_moments(m, weight);
}

/* Radii of nodes with up to this number of points are computed from their points; those of larger
 * nodes, from their children. */
enum { RADIUS_POINTS = 1 << 16 };

static void set_radius(const core_gather_points *points, const gather_node *node,
                       gather_moments *m) {
  if (node->count <= RADIUS_POINTS || node->children == 0) {
    double most = 0;
    for (size_t i = node->first; i < (size_t)node->first + node->count; i++) {
      const double x = points->at[0][i] - m->at[0], y = points->at[1][i] - m->at[1],
                   z = points->at[2][i] - m->at[2];
      const double square = x * x + y * y + z * z;
      most = square > most ? square : most;
    }
    m->radius_mm = sqrt(most);
  }
  m->radius_mm *= 1 + 0x1p-40;
}

/* Computes the power and moments of node `at`, whose children have theirs. */
static void set_moments(core_gather_points *points, size_t at) {
  const gather_node *node = &points->nodes[at];
  double *power = &points->node_power[at * points->channels];
  for (size_t c = 0; c < points->channels; c++) {
    power[c] = 0;
    for (size_t i = node->first; node->children == 0 && i < (size_t)node->first + node->count;
         i++) {
      power[c] += (double)points->power[c][i];
    }
    for (size_t i = 0; i < node->children; i++) {
      power[c] += points->node_power[(node->child + i) * points->channels + c];
    }
  }
  for (size_t c = 0, group = 0; c < points->channels; c++) {
    if (points->group[c] == group) {
      gather_moments *m = &points->moments[at * points->groups + group];
      if (node->children == 0) {
        leaf_moments(points, node, points->power[c], m);
      } else {
        inner_moments(points, node, group, c, m);
      }
      set_radius(points, node, m);
      group++;
    }
  }
}

/* ---- building -------------------------------------------------------------------------------- */

/* Sets leaf_mm to the median edge of the leaves. All edges are powers of two, so it counts
 * exponents. */
static void find_leaf_size(core_gather_points *points) {
  enum { EXPONENTS = 2200, MIDDLE = 1100 };
  uint32_t count[EXPONENTS] = {0};
  for (size_t i = 0; i < points->node_count; i++) {
    const gather_node *node = &points->nodes[i];
    int exponent = -MIDDLE;
    if (node->edge_mm > 0) {
      frexp(node->edge_mm, &exponent);
    }
    count[exponent + MIDDLE] += node->children == 0 ? node->count : 0;
  }
  size_t below = 0;
  for (int i = 0; i < EXPONENTS && 2 * below < points->n; i++) {
    below += count[i];
    points->leaf_mm = ldexp(1, i - MIDDLE - 1);
  }
}

static void *shrunk(void *memory, size_t bytes) {
  void *moved = realloc(memory, bytes);
  return moved != NULL ? moved : memory;
}

static void finish_points(core_gather_points *points) {
  find_leaf_size(points);
  free_build(points->build);
  points->build = NULL;
}

/* Returns the number of items of the present phase. */
static size_t items(const core_gather_points *points) {
  const gather_build *b = points->build;
  switch (b->phase) {
  case NODES:
    return SIZE_MAX;
  case COLLECT:
    return points->n;
  case GROUPS:
    return SIZE_MAX;
  case MOMENTS:
    return points->node_count;
  default:
    return b->end - b->begin;
  }
}

static void keep_box(core_gather_points *points) {
  for (size_t k = 0; k < 3; k++) {
    points->least[k] = points->build->least[k];
    points->most[k] = points->build->most[k];
    points->reach_mm = fmax(points->reach_mm, fmax(fabs(points->least[k]), fabs(points->most[k])));
  }
}

static void keep_memory(core_gather_points *points) {
  const size_t nodes = points->node_count;
  points->nodes = shrunk(points->nodes, nodes * sizeof *points->nodes);
  points->moments = shrunk(points->moments, nodes * points->groups * sizeof *points->moments);
  points->node_power =
      shrunk(points->node_power, nodes * points->channels * sizeof *points->node_power);
}

/* Begins the next phase. Returns true after the last one. */
static bool next_phase(core_gather_points *points) {
  gather_build *b = points->build;
  b->at = 0;
  switch (b->phase) {
  case BOX:
    set_cube(b);
    if (b->head == 0 && b->tail == 1) {
      keep_box(points);
      memcpy(points->nodes[0].corner, b->corner, sizeof b->corner);
      points->nodes[0].edge_mm = b->edge_mm;
    }
    b->phase = KEYS;
    break;
  case KEYS:
    b->phase = COUNT;
    b->digit = 0;
    break;
  case COUNT:
    b->phase = MOVE;
    start_moving(b);
    break;
  case MOVE:
    end_moving(b);
    b->digit++;
    b->phase = b->digit < DIGITS ? COUNT : NODES;
    break;
  case NODES:
    b->phase = next_part(points) ? BOX : COLLECT;
    break;
  case COLLECT:
    b->phase = GROUPS;
    break;
  case GROUPS:
    keep_memory(points);
    b->phase = MOMENTS;
    break;
  default:
    return true;
  }
  return false;
}

/* Processes up to `count` items of the present phase. Returns whether the phase is complete. */
static bool process_items(core_gather_points *points, size_t count) {
  gather_build *b = points->build;
  switch (b->phase) {
  case BOX:
    box(b, count);
    break;
  case KEYS:
    make_keys(b, count);
    break;
  case COUNT:
    count_digits(b, count);
    break;
  case MOVE:
    move_digits(b, count);
    break;
  case NODES:
    for (size_t i = 0; i < count && b->node < points->node_count; i++) {
      make_children(points);
      b->node = b->node == b->head ? b->tail : b->node + 1;
    }
    return b->node >= points->node_count;
  case COLLECT:
    collect(points, count);
    break;
  case GROUPS:
    find_group(points);
    return b->pair[0] == points->channels;
  default:
    for (size_t i = 0; i < count; i++) {
      set_moments(points, points->node_count - 1 - b->at - i);
    }
    break;
  }
  b->at += count;
  return b->at == items(points);
}

bool core_gather_points_build(core_gather_points *points, uint64_t work_ns) {
  double left_ns = (double)work_ns;
  while (points->build != NULL && left_ns > 0) {
    const gather_build *b = points->build;
    const size_t rest = items(points) - b->at;
    const double cost = b->phase == GROUPS ? 3 * (double)points->n : phase_ns[b->phase];
    const double fit = fmin(left_ns / cost + 1, 0x1p30);
    const size_t count = fit < (double)rest ? (size_t)fit : rest;
    left_ns -= (double)count * cost;
    if (process_items(points, count) && next_phase(points)) {
      finish_points(points);
    }
  }
  return points->build == NULL;
}

/* ---- cells ----------------------------------------------------------------------------------- */

static bool holds(const double corner[3], double edge_mm, const double x[3]) {
  bool held = true;
  for (int k = 0; k < 3; k++) {
    held = held && x[k] >= corner[k] && x[k] <= corner[k] + edge_mm;
  }
  return held;
}

/* The largest number of points in a node whose cube is a cell, and a district. Smaller cells have
 * shorter lists, but fewer queries share each. */
enum { CELL_POINTS = 80, DISTRICT_POINTS = 1024 };

/* Returns a cube for a query between small nodes. It is within the octant of the node's cube that
 * contains x; its edge is at most leaf_mm. */
static gather_cell cell_between(const core_gather_points *points, const gather_node *node,
                                const double x[3]) {
  double corner[3], edge_mm = node->edge_mm;
  memcpy(corner, node->corner, sizeof corner);
  bool halved = false;
  while (!halved || edge_mm > points->leaf_mm) {
    edge_mm *= 0.5;
    halved = true;
    for (int k = 0; k < 3; k++) {
      corner[k] = x[k] >= corner[k] + edge_mm ? corner[k] + edge_mm : corner[k];
    }
  }
  gather_cell cell = {.edge_mm = edge_mm};
  memcpy(cell.at, corner, sizeof corner);
  return cell;
}

/* The ratio of half the diagonal of a cube to its edge, sqrt(3) / 2, rounded up. */
#define HALF_DIAGONAL 0.8660254037844387
static gather_cell cell_of_cube(gather_cell cube, const double x[3]) {
  if (!(cube.edge_mm > 0)) {
    return (gather_cell){.at = {x[0], x[1], x[2]}};
  }
  for (int k = 0; k < 3; k++) {
    cube.at[k] += 0.5 * cube.edge_mm;
  }
  cube.radius_mm = fmax(gather_distance(cube.at, x), HALF_DIAGONAL * cube.edge_mm);
  return cube;
}

bool gather_cell_holds(const gather_cell *cell, const double x[3]) {
  bool held = cell->edge_mm > 0 && cell->radius_mm <= HALF_DIAGONAL * cell->edge_mm;
  for (int k = 0; k < 3; k++) {
    /* Rounding displaces the sides, so queries near them do not count as inside. */
    held = held && fabs(x[k] - cell->at[k]) + 0x1p-48 * fabs(x[k]) < 0.499 * cell->edge_mm;
  }
  return held;
}

gather_cell gather_cell_of(const core_gather_points *points, const double x[3],
                           gather_cell *district) {
  const gather_node *node = points->nodes, *around = NULL;
  gather_cell cell = {.at = {x[0], x[1], x[2]}};
  *district = cell;
  if (!holds(node->corner, node->edge_mm, x)) {
    return cell;
  }
  bool between = false;
  while (node->count > CELL_POINTS && node->children > 0) {
    const gather_node *child = points->nodes + node->child;
    size_t i = 0;
    while (i < node->children && !holds(child[i].corner, child[i].edge_mm, x)) {
      i++;
    }
    between = i == node->children;
    if (between) {
      break;
    }
    node = &child[i];
    around = around == NULL && node->count <= DISTRICT_POINTS ? node : around;
  }
  cell.edge_mm = node->edge_mm;
  memcpy(cell.at, node->corner, sizeof cell.at);
  if (between) {
    cell = cell_between(points, node, x);
  }
  cell = cell_of_cube(cell, x);
  *district = cell;
  if (around != NULL) {
    district->edge_mm = around->edge_mm;
    memcpy(district->at, around->corner, sizeof district->at);
    *district = cell_of_cube(*district, x);
  }
  return cell;
}

/* ---- order ----------------------------------------------------------------------------------- */

typedef struct keyed {
  uint64_t key;
  uint32_t index;
} keyed;

static int compare_keyed(const void *a, const void *b) {
  const keyed *one = a, *other = b;
  return one->key != other->key ? (one->key < other->key ? -1 : 1)
                                : (one->index > other->index) - (one->index < other->index);
}

static void cube_around(size_t n, const double *xyz, double corner[3], double *edge_mm) {
  double most[3];
  memcpy(corner, xyz, sizeof most);
  memcpy(most, xyz, sizeof most);
  for (size_t i = 0; i < 3 * n; i++) {
    corner[i % 3] = fmin(corner[i % 3], xyz[i]);
    most[i % 3] = fmax(most[i % 3], xyz[i]);
  }
  *edge_mm = fmax(fmax(most[0] - corner[0], most[1] - corner[1]), most[2] - corner[2]);
}

void core_gather_order(const core_gather_points *points, size_t n, const double *xyz,
                       uint32_t *order) {
  double corner[3] = {0}, edge_mm = 0;
  if (points != NULL) {
    memcpy(corner, points->nodes->corner, sizeof corner);
    edge_mm = points->nodes->edge_mm;
  } else if (n > 0) {
    cube_around(n, xyz, corner, &edge_mm);
  }
  const double per_mm = keys_per_mm(edge_mm);
  keyed *sorted = malloc(n * sizeof *sorted);
  for (size_t i = 0; i < n && sorted != NULL; i++) {
    sorted[i] = (keyed){morton(xyz + 3 * i, corner, per_mm), (uint32_t)i};
  }
  if (sorted != NULL) {
    qsort(sorted, n, sizeof *sorted, compare_keyed);
  }
  for (size_t i = 0; i < n; i++) {
    order[i] = sorted != NULL ? sorted[i].index : (uint32_t)i;
  }
  free(sorted);
}
