/* The code reads tables byte by byte, so that they may have any alignment, on machines of any byte
 * order. */
#include "core/transport/table.h"

#include <assert.h>
#include <math.h>
#include <pthread.h>
#include <string.h>

#include "core/transport/functions.h"
#include "core/transport/table_data.h"
#include "core/transport/transport.h"

enum { TERMS_MAX = TRANSPORT_TABLE_TERMS_MAX, SERIES = 1 + TRANSPORT_TABLE_PANELS };

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

void transport_table_edges(const double *field, double kappa,
                           double edge[TRANSPORT_TABLE_PANELS + 1]) {
  const double reach =
      1 / (kappa / field[TRANSPORT_TABLE_REACH_DECAYS] + 1 / field[TRANSPORT_TABLE_REACH_MOST]);
  for (int i = 0; i <= TRANSPORT_TABLE_NEAR; i++) {
    edge[i] = fn_log(field[TRANSPORT_TABLE_EDGES + i]);
  }
  const double from = edge[TRANSPORT_TABLE_NEAR];
  const double width = (fn_log(reach) - from) / TRANSPORT_TABLE_FAR;
  for (int i = 1; i <= TRANSPORT_TABLE_FAR; i++) {
    edge[TRANSPORT_TABLE_NEAR + i] = from + i * width;
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

/* Reads a series and sums it over i and j with the values of T_i and T_j. Sets terms[k] to the
 * coefficients of T_k that result, in units of the quantum, and returns their number. */
static size_t read_series(struct reader *reader, const double *t, const double *v, double *terms) {
  const size_t count = read_count(reader, 1);
  for (size_t k = 0; k < count; k++) {
    terms[k] = 0;
    const size_t rows = read_count(reader, 0);
    for (size_t i = 0; i < rows; i++) {
      double sum = 0;
      const size_t columns = read_count(reader, 0);
      for (size_t j = 0; j < columns; j++) {
        sum += (double)read_integer(reader) * v[j];
      }
      terms[k] += sum * t[i];
    }
  }
  return count;
}

/* Reads one side completely, as a check. Returns whether it is well formed. */
static bool pass_over_side(struct reader *reader) {
  static const double zeros[TERMS_MAX];
  double terms[TERMS_MAX];
  for (int i = 0; i < SERIES; i++) {
    const size_t count = read_series(reader, zeros, zeros, terms);
    if (i == 0 && count != 1) {
      reader->good = false;
    }
  }
  return reader->good;
}

static bool sane(const double *field) {
  bool good = field[TRANSPORT_TABLE_ERROR] >= 0 && field[TRANSPORT_TABLE_QUANTUM] > 0 &&
              field[TRANSPORT_TABLE_ALBEDO_LEAST] > 0 &&
              field[TRANSPORT_TABLE_ALBEDO_LEAST] < field[TRANSPORT_TABLE_ALBEDO_MOST] &&
              field[TRANSPORT_TABLE_ALBEDO_MOST] < 1 &&
              field[TRANSPORT_TABLE_ETA_LEAST] >= TRANSPORT_ETA_MIN &&
              field[TRANSPORT_TABLE_ETA_LEAST] < 1 && field[TRANSPORT_TABLE_ETA_MOST] > 1 &&
              field[TRANSPORT_TABLE_ETA_MOST] <= TRANSPORT_ETA_MAX &&
              field[TRANSPORT_TABLE_REACH_DECAYS] > 0 && field[TRANSPORT_TABLE_EDGES] > 0;
  for (int i = 0; i < TRANSPORT_TABLE_NEAR; i++) {
    good &= field[TRANSPORT_TABLE_EDGES + i] < field[TRANSPORT_TABLE_EDGES + i + 1];
  }
  const double shortest =
      1 / (1 / field[TRANSPORT_TABLE_REACH_DECAYS] + 1 / field[TRANSPORT_TABLE_REACH_MOST]);
  return good && shortest > field[TRANSPORT_TABLE_EDGES + TRANSPORT_TABLE_NEAR];
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
  for (int side = 0; side < TRANSPORT_TABLE_SIDES; side++) {
    table->side[side] = reader.at;
    if (!pass_over_side(&reader)) {
      return false;
    }
  }
  table->side[TRANSPORT_TABLE_SIDES] = reader.at;
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

bool transport_table_covers(const transport_table *table, double albedo, double eta) {
  return albedo >= table->field[TRANSPORT_TABLE_ALBEDO_LEAST] &&
         albedo <= table->field[TRANSPORT_TABLE_ALBEDO_MOST] &&
         eta >= table->field[TRANSPORT_TABLE_ETA_LEAST] &&
         eta <= table->field[TRANSPORT_TABLE_ETA_MOST];
}

double transport_table_error(const transport_table *table) {
  return table->field[TRANSPORT_TABLE_ERROR];
}

void transport_table_look_up(const transport_table *table, double albedo, double eta,
                             transport_series *series) {
  assert(transport_table_covers(table, albedo, eta));
  const double *field = table->field;
  const enum transport_table_side side = transport_table_side(eta);
  double range[2], t[TERMS_MAX], v[TERMS_MAX], total[TERMS_MAX];
  transport_table_v_range(field, side, range);
  chebyshev(mapped(transport_table_v(eta), range[0], range[1]), v);
  chebyshev(mapped(transport_table_t(albedo), transport_table_t(field[TRANSPORT_TABLE_ALBEDO_MOST]),
                   transport_table_t(field[TRANSPORT_TABLE_ALBEDO_LEAST])),
            t);
  struct reader reader = {table->side[side], table->side[side + 1], true};
  read_series(&reader, t, v, total);
  series->kappa = transport_kappa(albedo);
  series->total = albedo * fn_exp(total[0] * field[TRANSPORT_TABLE_QUANTUM]);
  series->ln_albedo = fn_log(albedo);
  transport_table_edges(field, series->kappa, series->edge);
  for (int i = 0; i < TRANSPORT_TABLE_PANELS; i++) {
    series->terms[i] = read_series(&reader, t, v, series->term[i]);
    for (size_t k = 0; k < series->terms[i]; k++) {
      series->term[i][k] *= field[TRANSPORT_TABLE_QUANTUM];
    }
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

double transport_series_at(const transport_series *series, double y) {
  const double *edge = series->edge;
  assert(y >= edge[0] - 1e-9 && y <= edge[TRANSPORT_TABLE_PANELS] + 1e-9);
  int panel = 0;
  while (panel < TRANSPORT_TABLE_PANELS - 1 && y > edge[panel + 1]) {
    panel++;
  }
  const double q =
      sum_of(series->term[panel], series->terms[panel], mapped(y, edge[panel], edge[panel + 1]));
  return q + series->ln_albedo + fn_log(1 + series->kappa * fn_exp(y));
}
