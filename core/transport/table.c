/* Reads and evaluates the table of solutions. It reads bytes one by one, so the table may have any
 * alignment and the machine any byte order. */
#include "core/transport/table.h"
#include "core/transport/decay.h"

#include <assert.h>
#include <math.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>

#include "core/chebyshev.h"
#include "core/solver/solver.h"
#include "core/transport/functions.h"

enum {
  TERMS_MAX = TRANSPORT_TABLE_TERMS_MAX,
  PANELS = TRANSPORT_TABLE_PANELS,
  SIDES = TRANSPORT_TABLE_SIDES,
  TOTALS_MAX = 2,                   /* totals of one side of eta */
  SERIES_MAX = TOTALS_MAX + PANELS, /* series of one side of eta */
  LANES = 4,                        /* number of coefficients of a group */
  GROUPS_MAX = TERMS_MAX / LANES,
  BLOCKS_MAX = TERMS_MAX * TERMS_MAX, /* of one i: with each l and j */
};

typedef int32_t group __attribute__((vector_size(LANES * sizeof(int32_t))));
typedef double lanes __attribute__((vector_size(LANES * sizeof(double))));
typedef double pair __attribute__((vector_size(2 * sizeof(double))));

/* A series in the order of summation. The outermost index i is that of the albedo. The innermost is
 * k for a panel, and j for a total. The coefficients that share all indices but the innermost are a
 * block, padded with zeros to groups of LANES. The blocks of each i are sorted by their number of
 * groups, the longest first, and an empty one makes their number even. The groups are stored by i,
 * then by their place in the block, then by block. */
struct packed {
  size_t terms;      /* of k for a panel, of j for a total */
  size_t of_albedo;  /* of i */
  size_t blocks_end; /* blocks of one i have smaller indices l TERMS_MAX + j, or l TERMS_MAX */
  size_t first[TERMS_MAX]; /* index of the weight of the first block of each i */
  uint16_t *weight;        /* of each block: l TERMS_MAX + j for a panel, l for a total */
  uint32_t at[TERMS_MAX][GROUPS_MAX + 1]; /* where the groups of each i and place begin, and end */
  group *groups;
};

/* All series of both sides of eta: of isotropic scattering, then of D; the totals before the
 * panels. */
struct transport_packed {
  struct packed series[2 * SIDES][SERIES_MAX];
};

/* u = ln((s + U_BEGIN) / (U_END - s)) */
#define U_BEGIN 0.6
#define U_END 1.03

/* ---- coordinates ---------------------------------------------------------------------------- */

double transport_table_t(double albedo) {
  const double s = sqrt(1 - albedo);
  return fn_log(s * (1 + s) / albedo); /* since 1 - s = a / (1 + s) */
}

double transport_table_albedo(double t) {
  const double e = fn_exp(t);
  const double s = e / (1 + e);
  return (1 + s) / (1 + e);
}

double transport_table_u(double albedo) {
  const double s = sqrt(1 - albedo);
  return fn_log((s + U_BEGIN) / (U_END - s));
}

double transport_table_albedo_of_u(double u) {
  const double e = fn_exp(u);
  const double s = fmax((U_END * e - U_BEGIN) / (1 + e), 0);
  return (1 - s) * (1 + s);
}

double transport_table_w(double g) {
  return g * (1 + g / 20);
}

double transport_table_g(double w) {
  return 2 * w / (1 + sqrt(1 + w / 5));
}

enum transport_table_side transport_table_side(double eta) {
  return eta < 1 ? TRANSPORT_TABLE_BELOW_1 : TRANSPORT_TABLE_FROM_1;
}

double transport_table_v(double eta) {
  return eta < 1 ? sqrt((1 - eta) * (1 + eta)) : sqrt((eta - 1) * (eta + 1)) / eta;
}

double transport_table_eta(enum transport_table_side side, double v) {
  const double root = sqrt((1 - v) * (1 + v));
  return side == TRANSPORT_TABLE_BELOW_1 ? root : 1 / root;
}

void transport_table_v_range(const double *field, enum transport_table_side side, double range[2]) {
  range[0] = 0;
  range[1] = transport_table_v(field[side == TRANSPORT_TABLE_BELOW_1 ? TRANSPORT_TABLE_ETA_LEAST
                                                                     : TRANSPORT_TABLE_ETA_MOST]);
}

void transport_table_edges(const double *field, bool of_difference, double kappa,
                           double edge[PANELS + 1]) {
  const double *fixed = &field[of_difference ? TRANSPORT_TABLE_D_EDGES : TRANSPORT_TABLE_EDGES];
  const int near = of_difference ? TRANSPORT_TABLE_D_NEAR : TRANSPORT_TABLE_NEAR;
  const double decays =
      field[of_difference ? TRANSPORT_TABLE_D_REACH_DECAYS : TRANSPORT_TABLE_REACH_DECAYS];
  const double most =
      field[of_difference ? TRANSPORT_TABLE_D_REACH_MOST : TRANSPORT_TABLE_REACH_MOST];
  const double reach = 1 / (kappa / decays + 1 / most);
  for (int i = 0; i <= near; i++) {
    edge[i] = fn_log(fixed[i]);
  }
  const double width = (fn_log(reach) - edge[near]) / (PANELS - near);
  for (int i = 1; i <= PANELS - near; i++) {
    edge[near + i] = edge[near] + i * width;
  }
}

/* Returns the position of x in a range, mapped to -1 to 1 and clamped to that. */
static double mapped(double x, double from, double to) {
  return fmin(fmax(2 * (x - from) / (to - from) - 1, -1), 1);
}

/* ---- bytes ---------------------------------------------------------------------------------- */

static uint64_t little_endian(const uint8_t *bytes, size_t length) {
  uint64_t value = 0;
  for (size_t i = 0; i < length; i++) {
    value |= (uint64_t)bytes[i] << 8 * i;
  }
  return value;
}

static double number_at(const uint8_t *bytes) {
  const uint64_t bits = little_endian(bytes, 8);
  double number;
  memcpy(&number, &bits, sizeof number);
  return number;
}

uint64_t transport_table_checksum(const uint8_t *bytes, size_t length) {
  uint64_t hash = UINT64_C(0xcbf29ce484222325);
  for (size_t i = 0; i < length; i++) {
    hash = (hash ^ bytes[i]) * UINT64_C(0x100000001b3);
  }
  return hash;
}

/* Returns the number at *at, and moves *at behind it. The checksum guarantees that the bytes are a
 * table. */
static size_t read_count(const uint8_t **at) {
  return *(*at)++;
}

static size_t number_of_totals(int side) {
  return side < SIDES ? 1 : TOTALS_MAX;
}

/* Reads a series of one side. count[]: the number of coefficients of the block with each
 * combination of the indices i, l and j (panels) or i and l (totals). A call with rank NULL sets
 * count[]. Another call stores the coefficients, where rank[] is each block's place among those of
 * its i. */
static void read_series(const uint8_t **at, bool of_g, bool is_total, struct packed *series,
                        uint8_t *count, const uint16_t *rank) {
  const size_t of_y = read_count(at);
  for (size_t k = 0; k < of_y; k++) {
    const size_t of_g_terms = of_g ? read_count(at) : 1;
    for (size_t l = 0; l < of_g_terms; l++) {
      const size_t of_albedo = read_count(at);
      series->of_albedo = of_albedo > series->of_albedo ? of_albedo : series->of_albedo;
      for (size_t i = 0; i < of_albedo; i++) {
        const size_t of_v = read_count(at);
        for (size_t j = 0; j < of_v; j++) {
          const int32_t c = (int32_t)core_packed_integer(at);
          const size_t inner = is_total ? j : k;
          series->terms = inner < series->terms ? series->terms : inner + 1;
          const size_t of_i = l * TERMS_MAX + (is_total ? 0 : j), block = i * BLOCKS_MAX + of_i;
          if (rank == NULL) {
            count[block] = (uint8_t)(inner + 1);
            series->blocks_end = of_i < series->blocks_end ? series->blocks_end : of_i + 1;
          } else {
            series->groups[series->at[i][inner / LANES] + rank[block]][inner % LANES] = c;
          }
        }
      }
    }
  }
}

/* Sorts the blocks of one i by count[] and sets rank[]. blocks: the number of those of smaller i.
 * *groups: the number of their groups, to which those of this i are added. Returns the number of blocks,
 * made even. */
static size_t sort_blocks(struct packed *series, size_t i, bool is_total, const uint8_t *count,
                          uint16_t *rank, size_t blocks, size_t *groups) {
  size_t longer[GROUPS_MAX + 1] = {0}; /* number of blocks with more groups than the index */
  for (size_t b = 0; b < series->blocks_end; b++) {
    for (size_t place = 0; place * LANES < count[b]; place++) {
      longer[place]++;
    }
  }
  series->first[i] = blocks;
  for (size_t place = 0; place <= GROUPS_MAX; place++) {
    series->at[i][place] = (uint32_t)*groups;
    *groups += longer[place] + longer[place] % 2;
  }
  const size_t number = longer[0] + longer[0] % 2;
  for (size_t b = 0; b < series->blocks_end; b++) {
    if (count[b] > 0) {
      rank[b] = (uint16_t)longer[(count[b] + LANES - 1u) / LANES]++;
      series->weight[blocks + rank[b]] = (uint16_t)(is_total ? b / TERMS_MAX : b);
    }
  }
  return number;
}

/* Allocates a series and sets its blocks from count[]. Returns false if memory runs out. */
static bool lay_blocks(struct packed *series, bool is_total, const uint8_t *count, uint16_t *rank) {
  size_t blocks = series->of_albedo, groups = 0;
  for (size_t i = 0; i < series->of_albedo; i++) {
    for (size_t b = 0; b < series->blocks_end; b++) {
      blocks += count[i * BLOCKS_MAX + b] > 0;
    }
  }
  series->weight = calloc(blocks + 1, sizeof *series->weight);
  blocks = 0;
  for (size_t i = 0; series->weight != NULL && i < series->of_albedo; i++) {
    const size_t b = i * BLOCKS_MAX;
    blocks += sort_blocks(series, i, is_total, &count[b], &rank[b], blocks, &groups);
  }
  series->groups = calloc(groups + 1, sizeof *series->groups);
  return series->weight != NULL && series->groups != NULL;
}

/* Reads all series of one side. count: zeros for the blocks of all i, which it leaves so; rank: as many.
 * Returns false if memory runs out. */
static bool pack_side(const uint8_t **at, int side, struct packed series[SERIES_MAX],
                      uint8_t *count, uint16_t *rank) {
  const size_t totals = number_of_totals(side);
  bool good = true;
  for (size_t n = 0; n < totals + PANELS && good; n++) {
    const bool is_total = n < totals;
    const uint8_t *again = *at;
    read_series(at, side >= SIDES, is_total, &series[n], count, NULL);
    good = lay_blocks(&series[n], is_total, count, rank);
    if (good) {
      read_series(&again, side >= SIDES, is_total, &series[n], count, rank);
    }
    for (size_t i = 0; i < series[n].of_albedo; i++) {
      memset(&count[i * BLOCKS_MAX], 0, series[n].blocks_end);
    }
  }
  return good;
}

bool transport_table_open(transport_table *table, const uint8_t *bytes, size_t length) {
  if (length < TRANSPORT_TABLE_HEADER_BYTES || memcmp(bytes, TRANSPORT_TABLE_MAGIC, 8) != 0 ||
      little_endian(bytes + 8, 4) != TRANSPORT_TABLE_VERSION ||
      little_endian(bytes + 12, 4) != length ||
      little_endian(bytes + 16, 8) != transport_table_checksum(bytes + 24, length - 24)) {
    return false;
  }
  for (int i = 0; i < TRANSPORT_TABLE_FIELDS; i++) {
    table->field[i] = number_at(bytes + 24 + 8 * i);
  }
  const uint8_t *at = bytes + TRANSPORT_TABLE_HEADER_BYTES;
  /* All sides share these: whoever frees such blocks and takes others has to clear their pages anew. */
  const size_t most = (size_t)BLOCKS_MAX * TERMS_MAX;
  uint8_t *count = calloc(most, 1);
  uint16_t *rank = malloc(most * sizeof *rank);
  table->packed = calloc(1, sizeof *table->packed);
  bool good = count != NULL && rank != NULL && table->packed != NULL;
  for (int side = 0; side < 2 * SIDES && good; side++) {
    good = pack_side(&at, side, table->packed->series[side], count, rank);
  }
  free(count);
  free(rank);
  if (!good) {
    transport_table_close(table);
  }
  return good;
}

void transport_table_close(transport_table *table) {
  for (int side = 0; table->packed != NULL && side < 2 * SIDES; side++) {
    for (int n = 0; n < SERIES_MAX; n++) {
      free(table->packed->series[side][n].weight);
      free(table->packed->series[side][n].groups);
    }
  }
  free(table->packed);
  table->packed = NULL;
}

__asm__(".pushsection .rodata\n"
        ".balign 16\n"
        ".globl transport_table_data, transport_table_data_end\n"
        ".hidden transport_table_data, transport_table_data_end\n"
        ".type transport_table_data, %object\n"
        "transport_table_data:\n"
        ".incbin \"core/transport/transport.table\"\n"
        "transport_table_data_end:\n"
        ".byte 0\n"
        ".size transport_table_data, transport_table_data_end - transport_table_data\n"
        ".popsection\n");

static transport_table shipped;
static bool shipped_is_good;
static pthread_once_t shipped_once = PTHREAD_ONCE_INIT;

static void open_shipped(void) {
  const size_t length = (size_t)(transport_table_data_end - transport_table_data);
  shipped_is_good = transport_table_open(&shipped, transport_table_data, length);
}

const transport_table *transport_table_shipped(void) {
  pthread_once(&shipped_once, open_shipped);
  return shipped_is_good ? &shipped : NULL;
}

/* ---- looking up ----------------------------------------------------------------------------- */

bool transport_table_covers(const transport_table *table, double albedo, double g, double eta) {
  const double *field = table->field;
  return albedo >= field[TRANSPORT_TABLE_ALBEDO_LEAST] && albedo <= 1 &&
         g >= field[TRANSPORT_TABLE_G_LEAST] && g <= field[TRANSPORT_TABLE_G_MOST] &&
         eta >= field[TRANSPORT_TABLE_ETA_LEAST] && eta <= field[TRANSPORT_TABLE_ETA_MOST];
}

/* Returns how many of the ascending limits are at most x. */
static size_t band(double x, const double *limits, size_t count) {
  size_t i = 0;
  while (i < count && x >= limits[i]) {
    i++;
  }
  return i;
}

static const double albedo_limits[TRANSPORT_TABLE_BANDS_ALBEDO - 1] = {1.0 / 11, 0.5, 0.9, 0.999};

size_t transport_table_albedo_band(double albedo) {
  return band(albedo, albedo_limits, TRANSPORT_TABLE_BANDS_ALBEDO - 1);
}

double transport_table_albedo_end(size_t band) {
  return band < TRANSPORT_TABLE_BANDS_ALBEDO - 1 ? albedo_limits[band] : 1;
}

size_t transport_table_region(double albedo, double g, double eta, double x) {
  static const double g_limits[TRANSPORT_TABLE_BANDS_G - 1] = {-0.25, 0.6, 0.85};
  static const double eta_limits[TRANSPORT_TABLE_BANDS_ETA - 1] = {1.5};
  static const double x_limits[TRANSPORT_TABLE_BANDS_X - 1] = {0.05, 1, 10, 20, 100};
  size_t region = band(g, g_limits, TRANSPORT_TABLE_BANDS_G - 1);
  region = region * TRANSPORT_TABLE_BANDS_ALBEDO + transport_table_albedo_band(albedo);
  region =
      region * TRANSPORT_TABLE_BANDS_ETA + band(eta, eta_limits, TRANSPORT_TABLE_BANDS_ETA - 1);
  return region * TRANSPORT_TABLE_BANDS_X + band(x, x_limits, TRANSPORT_TABLE_BANDS_X - 1);
}

double transport_table_error(const transport_table *table, double albedo, double g, double eta,
                             double x_least, double x_most) {
  assert(x_least >= 0 && x_least <= x_most);
  const double isotropic = table->field[TRANSPORT_TABLE_ERROR];
  double error = 0;
  const size_t first = transport_table_region(albedo, g, eta, x_least);
  /* A range that ends where a band begins does not belong to that band. */
  const size_t last = transport_table_region(albedo, g, eta, fmax(x_least, x_most * (1 - 0x1p-40)));
  for (size_t i = first; i <= last && g != 0; i++) {
    error = fmax(error, table->field[TRANSPORT_TABLE_D_ERRORS + i]);
  }
  return g == 0 ? isotropic : error;
}

double transport_table_total_error(const transport_table *table, double g) {
  return table->field[g == 0 ? TRANSPORT_TABLE_ERROR : TRANSPORT_TABLE_TOTALS_ERROR];
}

/* Sets values[] to the polynomials of v at this eta, on its side. */
static void polynomials_of_v(const double *field, double eta, double *values) {
  double range[2];
  transport_table_v_range(field, transport_table_side(eta), range);
  core_chebyshev_polynomials(TERMS_MAX, mapped(transport_table_v(eta), range[0], range[1]), values);
}

/* Completes a difference whose terms have been set: joins its panels and sets last_slope. */
static void end_difference(transport_difference *difference) {
  for (size_t i = 0; i < PANELS; i++) {
    difference->terms[i] = difference->terms[i] < 2 ? 2 : difference->terms[i];
  }
  transport_join_panels(PANELS, TERMS_MAX, difference->term[0]);
  const double *last = difference->term[PANELS - 1], *edge = difference->edge;
  double slope = 0; /* the derivative of T_k at 1 is k^2 */
  for (size_t k = 1; k < difference->terms[PANELS - 1]; k++) {
    slope += (double)(k * k) * last[k];
  }
  difference->last_slope = 2 * slope / (edge[PANELS] - edge[PANELS - 1]);
}

/* ---- summing -------------------------------------------------------------------------------- */

/* The polynomials of g and v at the medium: weights of the blocks of one part. */
struct weights {
  double of_l[TERMS_MAX];
  double of_v[TERMS_MAX];
  double both[TERMS_MAX * TERMS_MAX]; /* [l][j] */
};

static void set_weights(const double *field, bool of_difference, double g, double eta,
                        struct weights *weights) {
  polynomials_of_v(field, eta, weights->of_v);
  if (of_difference) {
    const double first = transport_table_w(field[TRANSPORT_TABLE_G_LEAST]);
    const double last = transport_table_w(field[TRANSPORT_TABLE_G_MOST]);
    core_chebyshev_polynomials(TERMS_MAX, mapped(transport_table_w(g), first, last), weights->of_l);
  } else {
    memset(weights->of_l, 0, sizeof weights->of_l);
    weights->of_l[0] = 1;
  }
  for (size_t l = 0; l < (of_difference ? TERMS_MAX : 1); l++) {
    for (size_t j = 0; j < TERMS_MAX; j++) {
      weights->both[l * TERMS_MAX + j] = weights->of_l[l] * weights->of_v[j];
    }
  }
}

/* Sets sum[] to the weighted sum of all blocks with the albedo's index i. */
static void sum_blocks(const struct packed *series, size_t i, const double *weight, double *sum) {
  const uint32_t *at = series->at[i];
  const uint16_t *blocks = &series->weight[series->first[i]];
  for (size_t place = 0; place * LANES < series->terms; place++) {
    const group *groups = &series->groups[at[place]];
    pair low[2] = {{0}}, high[2] = {{0}};
    for (size_t b = 0; b < at[place + 1] - at[place]; b += 2) {
      for (int k = 0; k < 2; k++) {
        const lanes c = __builtin_convertvector(groups[b + k], lanes);
        low[k] += weight[blocks[b + k]] * __builtin_shufflevector(c, c, 0, 1);
        high[k] += weight[blocks[b + k]] * __builtin_shufflevector(c, c, 2, 3);
      }
    }
    low[0] += low[1];
    high[0] += high[1];
    memcpy(&sum[place * LANES], &low, sizeof *low);
    memcpy(&sum[place * LANES + 2], &high, sizeof *high);
  }
}

/* The sums over all indices but the albedo's, by the albedo's index. */
struct rows {
  double row[TERMS_MAX][TERMS_MAX];
};

/* One part of the table (isotropic scattering, or D) for one g and eta. */
struct part {
  const double *field;
  bool of_difference;
  size_t totals;
  const struct packed *series; /* series of this side of eta, the totals before the panels */
  double ends[2];              /* the albedo's coordinate, t or u, at the ends of its range */
  /* rows of each series; NULL: not kept, so they are summed for each medium */
  const struct rows *rows;
  struct weights weights;
};

static void set_part(const transport_table *table, bool of_difference, double g, double eta,
                     struct part *part) {
  const int side = (of_difference ? SIDES : 0) + (int)transport_table_side(eta);
  part->field = table->field;
  part->of_difference = of_difference;
  part->totals = number_of_totals(side);
  part->series = table->packed->series[side];
  const double least = table->field[TRANSPORT_TABLE_ALBEDO_LEAST];
  part->ends[0] = of_difference ? transport_table_u(1)
                                : transport_table_t(table->field[TRANSPORT_TABLE_ALBEDO_MOST]);
  part->ends[1] = of_difference ? transport_table_u(least) : transport_table_t(least);
  part->rows = NULL;
  set_weights(table->field, of_difference, g, eta, &part->weights);
}

/* Sets row[k] to the row of series n for the albedo's index i. */
static void sum_row(const struct part *part, size_t n, size_t i, double row[TERMS_MAX]) {
  const struct packed *series = &part->series[n];
  const struct weights *weights = &part->weights;
  const bool is_total = n < part->totals;
  const double quantum = part->field[!part->of_difference ? TRANSPORT_TABLE_QUANTUM
                                     : is_total           ? TRANSPORT_TABLE_TOTALS_QUANTUM
                                                          : TRANSPORT_TABLE_D_QUANTUM];
  sum_blocks(series, i, is_total ? weights->of_l : weights->both, row);
  if (is_total) {
    double sum = 0;
    for (size_t j = 0; j < series->terms; j++) {
      sum += row[j] * weights->of_v[j];
    }
    row[0] = sum;
  }
  for (size_t k = 0; k < series->terms; k++) {
    row[k] *= quantum;
  }
}

/* Adds of_albedo times row to terms. */
static void add_row(const double *row, size_t count, double of_albedo, double *terms) {
  for (size_t k = 0; k < count; k++) {
    terms[k] += of_albedo * row[k];
  }
}

/* Adds the Chebyshev coefficients of series n to term[], or the logarithm of a total over the albedo to
 * term[0]. */
static void sum_series(const struct part *part, size_t n, double albedo, size_t terms,
                       double *term) {
  double polynomial[TERMS_MAX], own[TERMS_MAX];
  const double at = part->of_difference ? transport_table_u(albedo) : transport_table_t(albedo);
  core_chebyshev_polynomials(part->series[n].of_albedo, mapped(at, part->ends[0], part->ends[1]),
                             polynomial);
  for (size_t i = 0; i < part->series[n].of_albedo; i++) {
    if (part->rows == NULL) {
      sum_row(part, n, i, own);
    }
    add_row(part->rows != NULL ? part->rows[n].row[i] : own, terms, polynomial[i], term);
  }
}

static double sum_total(const struct part *part, size_t n, double albedo) {
  double logarithm = 0;
  sum_series(part, n, albedo, 1, &logarithm);
  return albedo * fn_exp(logarithm);
}

static void sum_panels(const struct part *part, double albedo, size_t terms[PANELS],
                       double term[PANELS][TERMS_MAX]) {
  for (size_t i = 0; i < PANELS; i++) {
    terms[i] = part->series[part->totals + i].terms;
    memset(term[i], 0, sizeof term[i]);
    sum_series(part, part->totals + i, albedo, terms[i], term[i]);
  }
}

/* Sets series->difference, for g other than 0. kappa: the medium's decay rate. */
static void add_difference(const struct part *part, double albedo, double g, double kappa,
                           transport_series *series) {
  transport_difference *difference = &series->difference;
  transport_table_edges(part->field, true, transport_kappa(albedo), difference->edge);
  sum_panels(part, albedo, difference->terms, difference->term);
  end_difference(difference);
  series->g = g;
  series->kappa = kappa;
  series->total = sum_total(part, 0, albedo);
}

/* Sets the part of *series for isotropic scattering. The table covers the albedo. */
static void sum_isotropic(const struct part *part, double albedo, transport_series *series) {
  series->g = 0;
  series->kappa = transport_kappa(albedo);
  series->total = sum_total(part, 0, albedo);
  series->ln_albedo = fn_log(albedo);
  transport_table_edges(part->field, false, series->kappa, series->edge);
  sum_panels(part, albedo, series->terms, series->term);
}

static double Q_of(const transport_series *series, double y) {
  double Q;
  transport_series_Q(series, 1, &y, &Q);
  return Q;
}

/* Next to white, Q at a radius x is linear in kappa^2 / (1 + kappa x): light that diffuses from a depth
 * z has come sqrt(x^2 + z^2) far, so that ln R gains -kappa^2 z^2 / (2 (1 + kappa x)). 1 less the total
 * is in proportion to kappa. Lines lead there from the largest albedo and from one with BASE times
 * the absorption. */
#define BASE 2.8
static double bend_of(double kappa, double x) {
  return kappa * kappa / (1 + kappa * x);
}

static void extend_to_white(const struct part *part, double albedo, transport_series *series) {
  const double absorbed = 1 - part->field[TRANSPORT_TABLE_ALBEDO_MOST];
  const double kappa = transport_kappa(albedo);
  transport_series most;
  sum_isotropic(part, 1 - absorbed, &most);
  sum_isotropic(part, 1 - BASE * absorbed, series);
  for (int i = 0; i < PANELS; i++) {
    const size_t count = series->terms[i];
    double terms[TERMS_MAX] = {0}, polynomial[TERMS_MAX];
    for (size_t m = 0; m < count; m++) {
      double sine, s;
      fn_sincos(FN_PI * ((double)m + 0.5) / (double)count, &sine, &s);
      const double y = series->edge[i] + 0.5 * (1 + s) * (series->edge[i + 1] - series->edge[i]);
      const double x = fn_exp(y), at_most = Q_of(&most, y), bend = bend_of(most.kappa, x);
      const double further = (bend - bend_of(kappa, x)) / (bend_of(series->kappa, x) - bend);
      core_chebyshev_polynomials(count, s, polynomial);
      add_row(polynomial, count, (at_most + further * (at_most - Q_of(series, y))) / (double)count,
              terms);
    }
    for (size_t k = 0; k < count; k++) {
      series->term[i][k] = (k == 0 ? 1 : 2) * terms[k];
    }
  }
  series->kappa = kappa;
  series->total = 1 - (1 - most.total) * sqrt((1 - albedo) / absorbed);
  series->ln_albedo = fn_log(albedo);
}

void transport_table_look_up(const transport_table *table, double albedo, double g, double eta,
                             transport_series *series) {
  assert(transport_table_covers(table, albedo, g, eta));
  struct part part;
  set_part(table, false, 0, eta, &part);
  if (albedo > table->field[TRANSPORT_TABLE_ALBEDO_MOST]) {
    extend_to_white(&part, albedo, series);
  } else {
    sum_isotropic(&part, albedo, series);
  }
  if (g != 0) {
    set_part(table, true, g, eta, &part);
    add_difference(&part, albedo, g, transport_anisotropic_kappa(albedo, g), series);
  }
}

/* ---- slices ---------------------------------------------------------------------------------- */

/* The two parts of a slice with their rows: isotropic scattering, then D. */
struct transport_slice {
  const transport_table *table;
  double g, eta;
  struct part part[2];
  struct rows rows[2][SERIES_MAX];
};

transport_slice *transport_slice_create(const transport_table *table, double g, double eta) {
  assert(transport_table_covers(table, 0.5, g, eta));
  transport_slice *slice = calloc(1, sizeof *slice);
  if (slice == NULL) {
    return NULL;
  }
  slice->table = table;
  slice->g = g;
  slice->eta = eta;
  for (int d = 0; d < 2; d++) {
    struct part *part = &slice->part[d];
    set_part(table, d == 1, d == 1 ? g : 0, eta, part);
    for (size_t n = 0; n < part->totals + PANELS; n++) {
      for (size_t i = 0; i < part->series[n].of_albedo; i++) {
        sum_row(part, n, i, slice->rows[d][n].row[i]);
      }
    }
    part->rows = slice->rows[d];
  }
  return slice;
}

double transport_slice_total(const transport_slice *slice, bool diffuse, double albedo) {
  return sum_total(&slice->part[diffuse || slice->g != 0 ? 1 : 0], diffuse ? 1 : 0, albedo);
}

void transport_slice_look_up(const transport_slice *slice, double albedo, double kappa,
                             transport_series *series) {
  assert(transport_table_covers(slice->table, albedo, slice->g, slice->eta));
  sum_isotropic(&slice->part[0], albedo, series);
  if (slice->g != 0) {
    add_difference(&slice->part[1], albedo, slice->g, kappa, series);
  }
}

/* ---- evaluating ------------------------------------------------------------------------------ */

/* Returns a panel's series at its beginning, where T_k is (-1)^k, or at its end, where T_k is 1. */
static double at_end(const double *term, size_t count, bool begin) {
  double sum = 0;
  for (size_t k = 0; k < count; k++) {
    sum += begin && k % 2 == 1 ? -term[k] : term[k];
  }
  return sum;
}

void transport_join_panels(size_t panels, size_t count, double *terms) {
  for (size_t i = 0; i + 1 < panels; i++) {
    double *one = terms + i * count, *other = one + count;
    const double half = 0.5 * (at_end(other, count, true) - at_end(one, count, false));
    one[0] += 0.5 * half;
    one[1] += 0.5 * half;
    other[0] -= 0.5 * half;
    other[1] += 0.5 * half;
  }
}

/* Returns the index of the panel that contains y. */
static int panel_of(const double edge[PANELS + 1], double y) {
  int panel = 0;
  while (panel < PANELS - 1 && y > edge[panel + 1]) {
    panel++;
  }
  return panel;
}

/* Returns the series at y. Outside all panels it has the value of the nearest end. */
static double sum_at(const double edge[PANELS + 1], const size_t terms[PANELS],
                     const double term[PANELS][TERMS_MAX], double y) {
  const int panel = panel_of(edge, y);
  return core_chebyshev_sum(terms[panel], term[panel], mapped(y, edge[panel], edge[panel + 1]));
}

/* Returns by how much D at y exceeds D at its reach; 0 within the reach. */
static double beyond_reach(const transport_difference *difference, double y) {
  const double beyond = (y - difference->edge[PANELS]) / TRANSPORT_TABLE_D_FADES;
  return beyond > 0
             ? difference->last_slope * TRANSPORT_TABLE_D_FADES * (1 - fn_exp(-fmin(beyond, 50)))
             : 0;
}

enum { TOGETHER = 8 }; /* number of sums evaluated in parallel, to hide latency */

/* Adds the series at each y[i] to the sums; the y ascend. */
static void add_sums(const double edge[PANELS + 1], const size_t terms[PANELS],
                     const double term[PANELS][TERMS_MAX], size_t n, const double *y, double *out) {
  size_t i = 0;
  while (i < n) {
    const int panel = panel_of(edge, y[i]);
    if (i + TOGETHER > n || panel_of(edge, y[i + TOGETHER - 1]) != panel) {
      out[i] += sum_at(edge, terms, term, y[i]);
      i++;
      continue;
    }
    double s[TOGETHER], next[TOGETHER] = {0}, after[TOGETHER] = {0};
    for (size_t k = 0; k < TOGETHER; k++) {
      s[k] = mapped(y[i + k], edge[panel], edge[panel + 1]);
    }
    for (size_t j = terms[panel] - 1; j >= 1; j--) {
      for (size_t k = 0; k < TOGETHER; k++) {
        const double sum = term[panel][j] + 2 * s[k] * next[k] - after[k];
        after[k] = next[k];
        next[k] = sum;
      }
    }
    for (size_t k = 0; k < TOGETHER; k++) {
      out[i + k] += term[panel][0] + s[k] * next[k] - after[k];
    }
    i += TOGETHER;
  }
}

void transport_series_Q(const transport_series *series, size_t n, const double *y, double *Q) {
  const transport_difference *difference = &series->difference;
  memset(Q, 0, n * sizeof *Q);
  add_sums(series->edge, series->terms, series->term, n, y, Q);
  if (series->g != 0) {
    add_sums(difference->edge, difference->terms, difference->term, n, y, Q);
    for (size_t i = 0; i < n; i++) {
      Q[i] += beyond_reach(difference, y[i]);
    }
  }
}

double transport_series_at(const transport_series *series, double y) {
  return Q_of(series, y) + series->ln_albedo + fn_log(1 + series->kappa * fn_exp(y));
}
