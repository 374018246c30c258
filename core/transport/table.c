/* The code reads tables byte by byte, so that they may have any alignment, on machines of any byte
 * order. */
#include "core/transport/table.h"

#include <assert.h>
#include <math.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>

#include "core/transport/anisotropic.h"
#include "core/transport/functions.h"
#include "core/transport/table_data.h"
#include "core/transport/transport.h"

enum {
  TERMS_MAX = TRANSPORT_TABLE_TERMS_MAX,
  PANELS = TRANSPORT_TABLE_PANELS,
  SIDES = TRANSPORT_TABLE_SIDES,
  DIMENSIONS = 3, /* of a coefficient of D, besides y */
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

/* Sets values[k] to T_k(s) for k from 0 to TERMS_MAX - 1. */
static void chebyshev(double s, double *values) {
  values[0] = 1;
  values[1] = s;
  for (int k = 2; k < TERMS_MAX; k++) {
    values[k] = 2 * s * values[k - 1] - values[k - 2];
  }
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

struct reader {
  const uint8_t *at, *end;
  bool good;
};

static uint8_t read_byte(struct reader *reader) {
  if (reader->at == reader->end) {
    reader->good = false;
    return 0;
  }
  return *reader->at++;
}

/* Reads a number of terms, from `least` (0 or 1) to TERMS_MAX; any other number makes the reader
 * bad. */
static size_t read_count(struct reader *reader, size_t least) {
  const size_t count = read_byte(reader);
  if (count < least || count > TERMS_MAX) {
    reader->good = false;
    return least;
  }
  return count;
}

/* Reads an integer of at most 49 bits, which a double holds exactly. */
static int64_t read_integer(struct reader *reader) {
  uint64_t zigzag = 0;
  for (int shift = 0; shift < 49; shift += 7) {
    const uint8_t byte = read_byte(reader);
    zigzag |= (uint64_t)(byte & 0x7f) << shift;
    if (byte < 0x80) {
      return (int64_t)(zigzag >> 1) ^ -(int64_t)(zigzag & 1);
    }
  }
  reader->good = false;
  return 0;
}

/* Reads a sum over some indices, where basis[0] has the values of the first index's polynomials,
 * basis[1] those of the next one's, and so on. */
static double read_sum(struct reader *reader, const double (*basis)[TERMS_MAX], size_t indices) {
  if (indices == 0) {
    return (double)read_integer(reader);
  }
  double sum = 0;
  const size_t count = read_count(reader, 0);
  for (size_t i = 0; i < count; i++) {
    sum += read_sum(reader, basis + 1, indices - 1) * basis[0][i];
  }
  return sum;
}

/* Reads a series and sums it over all indices but k. Sets terms[k] to the coefficients of T_k that
 * result, in units of the quantum, and returns their number. */
static size_t read_series(struct reader *reader, const double (*basis)[TERMS_MAX], size_t indices,
                          double *terms) {
  const size_t count = read_count(reader, 1);
  for (size_t k = 0; k < count; k++) {
    terms[k] = read_sum(reader, basis, indices);
  }
  return count;
}

/* Reads one side of one part completely, as a check. Sets *panels to the end of the totals. Returns
 * whether it is well formed. */
static bool pass_over_side(struct reader *reader, size_t totals, size_t indices,
                           const uint8_t **panels) {
  static const double zeros[DIMENSIONS][TERMS_MAX];
  double terms[TERMS_MAX];
  for (size_t i = 0; i < totals + PANELS; i++) {
    *panels = i == totals ? reader->at : *panels;
    const size_t count = read_series(reader, zeros, indices, terms);
    if (i < totals && count != 1) {
      reader->good = false;
    }
  }
  return reader->good;
}

/* Returns whether the edges of a part ascend for every albedo. */
static bool edges_ascend(const double *field, bool of_difference) {
  const double kappa_most = 1;
  const int first = of_difference ? TRANSPORT_TABLE_D_EDGES : TRANSPORT_TABLE_EDGES;
  const int reach = of_difference ? TRANSPORT_TABLE_D_REACH_DECAYS : TRANSPORT_TABLE_REACH_DECAYS;
  double edge[PANELS + 1];
  bool good = field[first] > 0 && field[reach] > 0 && field[reach + 1] > 0;
  if (good) {
    transport_table_edges(field, of_difference, kappa_most, edge);
  }
  for (int i = 0; i < PANELS && good; i++) {
    good = edge[i] < edge[i + 1];
  }
  return good;
}

static bool sane(const double *field) {
  bool good = field[TRANSPORT_TABLE_ERROR] >= 0 && field[TRANSPORT_TABLE_QUANTUM] > 0 &&
              field[TRANSPORT_TABLE_ALBEDO_LEAST] > 0 &&
              field[TRANSPORT_TABLE_ALBEDO_LEAST] < field[TRANSPORT_TABLE_ALBEDO_MOST] &&
              field[TRANSPORT_TABLE_ALBEDO_MOST] < 1 &&
              field[TRANSPORT_TABLE_ETA_LEAST] >= TRANSPORT_ETA_MIN &&
              field[TRANSPORT_TABLE_ETA_LEAST] < 1 && field[TRANSPORT_TABLE_ETA_MOST] > 1 &&
              field[TRANSPORT_TABLE_ETA_MOST] <= TRANSPORT_ETA_MAX &&
              field[TRANSPORT_TABLE_D_QUANTUM] > 0 && field[TRANSPORT_TABLE_G_LEAST] > -1 &&
              field[TRANSPORT_TABLE_G_LEAST] < 0 && field[TRANSPORT_TABLE_G_MOST] > 0 &&
              field[TRANSPORT_TABLE_G_MOST] < 1 && field[TRANSPORT_TABLE_TOTALS_QUANTUM] > 0;
  for (int i = TRANSPORT_TABLE_TOTALS_ERROR; i < TRANSPORT_TABLE_FIELDS; i++) {
    good &= field[i] >= 0; /* errors */
  }
  return good && edges_ascend(field, false) && edges_ascend(field, true);
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
  struct reader reader = {bytes + TRANSPORT_TABLE_HEADER_BYTES, bytes + length, true};
  for (int side = 0; side < 2 * SIDES; side++) {
    table->side[side] = reader.at;
    if (!pass_over_side(&reader, side < SIDES ? 1 : 2, side < SIDES ? 2 : 3,
                        &table->panels[side])) {
      return false;
    }
  }
  table->side[2 * SIDES] = reader.at;
  return reader.at == reader.end && sane(table->field);
}

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

bool transport_table_covers_difference(const transport_table *table, double albedo, double g,
                                       double eta) {
  const double *field = table->field;
  return albedo >= field[TRANSPORT_TABLE_ALBEDO_LEAST] && albedo <= 1 &&
         g >= field[TRANSPORT_TABLE_G_LEAST] && g <= field[TRANSPORT_TABLE_G_MOST] &&
         eta >= field[TRANSPORT_TABLE_ETA_LEAST] && eta <= field[TRANSPORT_TABLE_ETA_MOST];
}

bool transport_table_covers(const transport_table *table, double albedo, double g, double eta) {
  return transport_table_covers_difference(table, albedo, g, eta) &&
         albedo <= table->field[TRANSPORT_TABLE_ALBEDO_MOST];
}

/* Returns the number of limits that a number has reached. */
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
  /* a range that ends where a band begins does not touch that band */
  const size_t last = transport_table_region(albedo, g, eta, fmax(x_least, x_most * (1 - 0x1p-40)));
  for (size_t i = first; i <= last && g != 0; i++) {
    error = fmax(error, table->field[TRANSPORT_TABLE_D_ERRORS + i]);
  }
  return g == 0 ? isotropic : error;
}

double transport_table_total_error(const transport_table *table, double g) {
  return table->field[g == 0 ? TRANSPORT_TABLE_ERROR : TRANSPORT_TABLE_TOTALS_ERROR];
}

double transport_table_diffuse_error(const transport_table *table, double albedo) {
  return table->field[TRANSPORT_TABLE_DIFFUSE_ERRORS + transport_table_albedo_band(albedo)];
}

/* Sets values to the polynomials of v on the side of this eta. */
static void polynomials_of_v(const double *field, double eta, double *values) {
  double range[2];
  transport_table_v_range(field, transport_table_side(eta), range);
  chebyshev(mapped(transport_table_v(eta), range[0], range[1]), values);
}

/* The same for the albedo, of isotropic scattering and of D, and for g. */
static void polynomials_of_t(const double *field, double albedo, double *values) {
  chebyshev(mapped(transport_table_t(albedo), transport_table_t(field[TRANSPORT_TABLE_ALBEDO_MOST]),
                   transport_table_t(field[TRANSPORT_TABLE_ALBEDO_LEAST])),
            values);
}

static void polynomials_of_u(const double *field, double albedo, double *values) {
  chebyshev(mapped(transport_table_u(albedo), transport_table_u(1),
                   transport_table_u(field[TRANSPORT_TABLE_ALBEDO_LEAST])),
            values);
}

static void polynomials_of_w(const double *field, double g, double *values) {
  chebyshev(mapped(transport_table_w(g), transport_table_w(field[TRANSPORT_TABLE_G_LEAST]),
                   transport_table_w(field[TRANSPORT_TABLE_G_MOST])),
            values);
}

/* Ends a difference whose terms have been read. */
static void end_difference(transport_difference *difference) {
  for (size_t i = 0; i < PANELS; i++) {
    difference->terms[i] = difference->terms[i] < 2 ? 2 : difference->terms[i];
  }
  transport_join_panels(PANELS, TERMS_MAX, difference->term[0]);
  const double *last = difference->term[PANELS - 1], *edge = difference->edge;
  double slope = 0; /* that of T_k at 1 is k^2 */
  for (size_t k = 1; k < difference->terms[PANELS - 1]; k++) {
    slope += (double)(k * k) * last[k];
  }
  difference->last_slope = 2 * slope / (edge[PANELS] - edge[PANELS - 1]);
}

static void read_panels(struct reader *reader, const double (*basis)[TERMS_MAX], size_t indices,
                        double quantum, size_t terms[PANELS], double term[PANELS][TERMS_MAX]) {
  for (int i = 0; i < PANELS; i++) {
    terms[i] = read_series(reader, basis, indices, term[i]);
    for (size_t k = 0; k < terms[i]; k++) {
      term[i][k] *= quantum;
    }
  }
}

/* Reads a series of one term for the logarithm of a total per albedo, and returns the total. */
static double read_total(struct reader *reader, const double (*basis)[TERMS_MAX], size_t indices,
                         double quantum, double albedo) {
  double logarithm[TERMS_MAX];
  read_series(reader, basis, indices, logarithm);
  return albedo * fn_exp(logarithm[0] * quantum);
}

void transport_table_difference(const transport_table *table, double albedo, double g, double eta,
                                transport_difference *difference) {
  assert(transport_table_covers_difference(table, albedo, g, eta));
  const double *field = table->field;
  const int side = SIDES + (int)transport_table_side(eta);
  double basis[DIMENSIONS][TERMS_MAX];
  polynomials_of_w(field, g, basis[0]);
  polynomials_of_u(field, albedo, basis[1]);
  polynomials_of_v(field, eta, basis[2]);
  struct reader reader = {table->side[side], table->side[side + 1], true};
  const double quantum = field[TRANSPORT_TABLE_TOTALS_QUANTUM];
  difference->total = read_total(&reader, basis, 3, quantum, albedo);
  difference->total_diffuse = read_total(&reader, basis, 3, quantum, albedo);
  difference->kappa = transport_anisotropic_kappa(albedo, g);
  difference->kappa_isotropic = transport_kappa(albedo);
  transport_table_edges(field, true, difference->kappa_isotropic, difference->edge);
  memset(difference->term, 0, sizeof difference->term);
  read_panels(&reader, basis, 3, field[TRANSPORT_TABLE_D_QUANTUM], difference->terms,
              difference->term);
  end_difference(difference);
}

void transport_table_look_up(const transport_table *table, double albedo, double g, double eta,
                             transport_series *series) {
  assert(transport_table_covers(table, albedo, g, eta));
  const double *field = table->field;
  const enum transport_table_side side = transport_table_side(eta);
  const double quantum = field[TRANSPORT_TABLE_QUANTUM];
  double basis[2][TERMS_MAX];
  polynomials_of_t(field, albedo, basis[0]);
  polynomials_of_v(field, eta, basis[1]);
  struct reader reader = {table->side[side], table->side[side + 1], true};
  series->g = g;
  series->kappa = transport_kappa(albedo);
  series->total = read_total(&reader, basis, 2, quantum, albedo);
  series->total_diffuse = (double)NAN;
  series->ln_albedo = fn_log(albedo);
  transport_table_edges(field, false, series->kappa, series->edge);
  read_panels(&reader, basis, 2, quantum, series->terms, series->term);
  if (g != 0) {
    transport_table_difference(table, albedo, g, eta, &series->difference);
    series->kappa = series->difference.kappa;
    series->total = series->difference.total;
    series->total_diffuse = series->difference.total_diffuse;
  }
}

/* ---- slices ---------------------------------------------------------------------------------- */

/* A series over k, as the table has it, and the albedo's index i; the other indices are summed. */
struct slice_series {
  size_t terms;     /* of k */
  size_t of_albedo; /* of i */
  double term[TERMS_MAX][TERMS_MAX];
};

/* The parts of a slice: of isotropic scattering, then of D. */
struct transport_slice {
  const transport_table *table;
  double g, eta;
  struct slice_series total, panel[PANELS];
  struct slice_series beam, diffuse, difference[PANELS];
};

/* Reads a series whose indices are k, that of g if of_g is not NULL, the albedo's and that of v. */
static void read_slice(struct reader *reader, const double *of_g, const double (*of_v)[TERMS_MAX],
                       double quantum, struct slice_series *series) {
  series->terms = read_count(reader, 1);
  series->of_albedo = 0;
  for (size_t k = 0; k < series->terms; k++) {
    const size_t outer = of_g != NULL ? read_count(reader, 0) : 1;
    for (size_t l = 0; l < outer; l++) {
      const double factor = of_g != NULL ? quantum * of_g[l] : quantum;
      const size_t count = read_count(reader, 0);
      series->of_albedo = count > series->of_albedo ? count : series->of_albedo;
      for (size_t i = 0; i < count; i++) {
        series->term[k][i] += factor * read_sum(reader, of_v, 1);
      }
    }
  }
}

transport_slice *transport_slice_create(const transport_table *table, double g, double eta) {
  assert(transport_table_covers_difference(table, 0.5, g, eta));
  transport_slice *slice = calloc(1, sizeof *slice);
  if (slice == NULL) {
    return NULL;
  }
  const double *field = table->field;
  const int side = transport_table_side(eta);
  double of_g[TERMS_MAX], of_v[1][TERMS_MAX];
  slice->table = table;
  slice->g = g;
  slice->eta = eta;
  polynomials_of_v(field, eta, of_v[0]);
  polynomials_of_w(field, g, of_g);
  struct reader reader = {table->side[side], table->side[side + 1], true};
  read_slice(&reader, NULL, of_v, field[TRANSPORT_TABLE_QUANTUM], &slice->total);
  for (int i = 0; i < PANELS; i++) {
    read_slice(&reader, NULL, of_v, field[TRANSPORT_TABLE_QUANTUM], &slice->panel[i]);
  }
  reader = (struct reader){table->side[SIDES + side], table->side[SIDES + side + 1], true};
  read_slice(&reader, of_g, of_v, field[TRANSPORT_TABLE_TOTALS_QUANTUM], &slice->beam);
  read_slice(&reader, of_g, of_v, field[TRANSPORT_TABLE_TOTALS_QUANTUM], &slice->diffuse);
  for (int i = 0; i < PANELS; i++) {
    read_slice(&reader, of_g, of_v, field[TRANSPORT_TABLE_D_QUANTUM], &slice->difference[i]);
  }
  return slice;
}

/* Sets the terms of k of a medium. Returns their number. */
static size_t sum_slice(const struct slice_series *series, const double *of_albedo, double *terms) {
  for (size_t k = 0; k < series->terms; k++) {
    double sum = 0;
    for (size_t i = 0; i < series->of_albedo; i++) {
      sum += series->term[k][i] * of_albedo[i];
    }
    terms[k] = sum;
  }
  return series->terms;
}

transport_slice_sums transport_slice_total(const transport_slice *slice, double albedo) {
  double of_t[TERMS_MAX], of_u[TERMS_MAX], beam[TERMS_MAX], diffuse[TERMS_MAX];
  polynomials_of_u(slice->table->field, albedo, of_u);
  sum_slice(&slice->diffuse, of_u, diffuse);
  if (slice->g == 0) {
    polynomials_of_t(slice->table->field, albedo, of_t);
    sum_slice(&slice->total, of_t, beam);
  } else {
    sum_slice(&slice->beam, of_u, beam);
  }
  return (transport_slice_sums){albedo * fn_exp(beam[0]), albedo * fn_exp(diffuse[0])};
}

void transport_slice_look_up(const transport_slice *slice, double albedo, double kappa,
                             transport_series *series) {
  assert(transport_table_covers(slice->table, albedo, slice->g, slice->eta));
  const double *field = slice->table->field;
  transport_difference *difference = &series->difference;
  double of_t[TERMS_MAX], of_u[TERMS_MAX];
  polynomials_of_t(field, albedo, of_t);
  polynomials_of_u(field, albedo, of_u);
  const transport_slice_sums totals = transport_slice_total(slice, albedo);
  series->g = slice->g;
  series->kappa = transport_kappa(albedo);
  series->total = totals.beam;
  series->total_diffuse = totals.diffuse;
  series->ln_albedo = fn_log(albedo);
  transport_table_edges(field, false, series->kappa, series->edge);
  for (int i = 0; i < PANELS; i++) {
    series->terms[i] = sum_slice(&slice->panel[i], of_t, series->term[i]);
  }
  if (slice->g != 0) {
    difference->kappa_isotropic = series->kappa;
    difference->kappa = kappa;
    difference->total = totals.beam;
    difference->total_diffuse = totals.diffuse;
    transport_table_edges(field, true, series->kappa, difference->edge);
    memset(difference->term, 0, sizeof difference->term);
    for (int i = 0; i < PANELS; i++) {
      difference->terms[i] = sum_slice(&slice->difference[i], of_u, difference->term[i]);
    }
    end_difference(difference);
    series->kappa = difference->kappa;
  }
}

/* ---- evaluating ------------------------------------------------------------------------------ */

/* Returns the sum of a panel's terms at its beginning or its end, where each polynomial is -1 or
 * 1. */
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

/* Returns the Chebyshev series at s, from -1 to 1, by Clenshaw's recurrence. */
static double sum_of(const double *terms, size_t count, double s) {
  double next = 0, after = 0;
  for (size_t k = count - 1; k >= 1; k--) {
    const double sum = terms[k] + 2 * s * next - after;
    after = next;
    next = sum;
  }
  return terms[0] + s * next - after;
}

/* Returns the panel that y is in. */
static int panel_of(const double edge[PANELS + 1], double y) {
  int panel = 0;
  while (panel < PANELS - 1 && y > edge[panel + 1]) {
    panel++;
  }
  return panel;
}

/* Returns the series of the panel that y is in. Outside all panels it is constant. */
static double sum_at(const double edge[PANELS + 1], const size_t terms[PANELS],
                     const double term[PANELS][TERMS_MAX], double y) {
  const int panel = panel_of(edge, y);
  return sum_of(term[panel], terms[panel], mapped(y, edge[panel], edge[panel + 1]));
}

/* Returns what D gains beyond its reach. */
static double beyond_reach(const transport_difference *difference, double y) {
  const double beyond = (y - difference->edge[PANELS]) / TRANSPORT_TABLE_D_FADES;
  return beyond > 0
             ? difference->last_slope * TRANSPORT_TABLE_D_FADES * (1 - fn_exp(-fmin(beyond, 50)))
             : 0;
}

double transport_difference_at(const transport_difference *difference, double y) {
  const double x = fn_exp(y);
  return sum_at(difference->edge, difference->terms, difference->term, y) +
         beyond_reach(difference, y) +
         fn_log((1 + difference->kappa * x) / (1 + difference->kappa_isotropic * x));
}

double transport_series_at(const transport_series *series, double y) {
  const double *edge = series->edge;
  const bool isotropic = series->g == 0;
  assert(y >= edge[0] - 1e-9 && y <= edge[PANELS] + 1e-9);
  const double q = sum_at(edge, series->terms, series->term, y);
  const double kappa = isotropic ? series->kappa : series->difference.kappa_isotropic;
  const double sum = q + series->ln_albedo + fn_log(1 + kappa * fn_exp(y));
  return isotropic ? sum : sum + transport_difference_at(&series->difference, y);
}

enum { TOGETHER = 8 }; /* sums side by side, which wait for each other less */

/* Adds the series at each y, in ascending order. */
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
