#include "core/tools/transport_table/nodes.h"
#include "core/tools/tools.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/transport/functions.h"
#include "core/transport/table.h"
#include "core/transport/transport.h"

/* The number of points in each direction. They suffice for the last coefficients to be below the
 * quantum. */
enum { NODES_T = 72, NODES_X = 32, NODES_V_MAX = NODES_FROM_1, PANELS = TRANSPORT_TABLE_PANELS };

enum { BYTES_MAX = 1 << 22 };

/* Returns cos(pi (i + 1/2) k / n). */
static double wave(size_t k, size_t i, size_t n) {
  double sine, cosine;
  fn_sincos(FN_PI * (double)((2 * i + 1) * k % (4 * n)) / (double)(2 * n), &sine, &cosine);
  return cosine;
}

/* Returns Chebyshev's point i of n between two ends. */
static double point(size_t i, size_t n, double from, double to) {
  return from + (to - from) * 0.5 * (1 + wave(1, i, n));
}

/* ---- points ---------------------------------------------------------------------------------- */

static size_t nodes_of(enum transport_table_side side) {
  return side == TRANSPORT_TABLE_BELOW_1 ? NODES_BELOW_1 : NODES_FROM_1;
}

static void make_radii(const double *field, table_sample *sample, size_t i) {
  double edge[PANELS + 1];
  transport_table_edges(field, transport_kappa(sample->albedo[i]), edge);
  for (size_t p = 0; p < PANELS; p++) {
    for (size_t k = 0; k < NODES_X; k++) {
      sample->x[(i * PANELS + p) * NODES_X + k] = fn_exp(point(k, NODES_X, edge[p], edge[p + 1]));
    }
  }
}

void nodes_make(const double *field, table_sample samples[NODES]) {
  const double t_first = transport_table_t(field[TRANSPORT_TABLE_ALBEDO_MOST]);
  const double t_last = transport_table_t(field[TRANSPORT_TABLE_ALBEDO_LEAST]);
  for (enum transport_table_side side = 0; side < TRANSPORT_TABLE_SIDES; side++) {
    double range[2];
    transport_table_v_range(field, side, range);
    for (size_t j = 0; j < nodes_of(side); j++, samples++) {
      const double v = point(j, nodes_of(side), range[0], range[1]);
      sample_make(samples, transport_table_eta(side, v), NODES_T, PANELS * NODES_X);
      for (size_t i = 0; i < NODES_T; i++) {
        samples->albedo[i] = transport_table_albedo(point(i, NODES_T, t_first, t_last));
        make_radii(field, samples, i);
      }
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

/* Transforms an array [x][t][v] along all three directions. */
static void transform_all(double *values, size_t nx, size_t nt, size_t nv) {
  for (size_t k = 0; k < nx; k++) {
    for (size_t i = 0; i < nt; i++) {
      transform(values + (k * nt + i) * nv, nv, 1);
    }
    for (size_t j = 0; j < nv; j++) {
      transform(values + k * nt * nv + j, nt, nv);
    }
  }
  for (size_t ij = 0; ij < nt * nv && nx > 1; ij++) {
    transform(values + ij, nx, nt * nv);
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

struct writer {
  uint8_t *bytes;
  size_t length;
};

static void put_byte(struct writer *writer, size_t byte) {
  if (writer->length == BYTES_MAX) {
    tools_fail("the table is too large");
  }
  writer->bytes[writer->length++] = (uint8_t)byte;
}

static void put_integer(struct writer *writer, int64_t value) {
  uint64_t zigzag = value < 0 ? (uint64_t)(-2 * value - 1) : (uint64_t)(2 * value);
  for (; zigzag >= 0x80; zigzag >>= 7) {
    put_byte(writer, (zigzag & 0x7f) | 0x80);
  }
  put_byte(writer, zigzag);
}

/* Returns the length of a row without the zeros at its end. */
static size_t used(const int64_t *row, size_t n) {
  while (n > 0 && row[n - 1] == 0) {
    n--;
  }
  return n;
}

static void put_rows(struct writer *writer, const int64_t *rows, size_t nt, size_t nv) {
  const size_t last = used(rows, nt * nv);
  const size_t count = (last + nv - 1) / nv;
  put_byte(writer, count);
  for (size_t i = 0; i < count; i++) {
    const size_t columns = used(rows + i * nv, nv);
    put_byte(writer, columns);
    for (size_t j = 0; j < columns; j++) {
      put_integer(writer, rows[i * nv + j]);
    }
  }
}

static void put_series(struct writer *writer, double quantum, double *values, size_t nx, size_t nt,
                       size_t nv) {
  transform_all(values, nx, nt, nv);
  int64_t *rounded = malloc(nx * nt * nv * sizeof *rounded);
  if (rounded == NULL) {
    tools_fail("out of memory");
  }
  for (size_t i = 0; i < nx * nt * nv; i++) {
    const double value = values[i] / quantum;
    if (!(fabs(value) < 0x1p47)) {
      tools_fail("a coefficient of the table is too large or not a number");
    }
    rounded[i] = llrint(value);
  }
  const size_t last = used(rounded, nx * nt * nv);
  const size_t count = last > 0 ? (last + nt * nv - 1) / (nt * nv) : 1;
  put_byte(writer, count);
  for (size_t k = 0; k < count; k++) {
    put_rows(writer, rounded + k * nt * nv, nt, nv);
  }
  free(rounded);
}

/* ---- tables ---------------------------------------------------------------------------------- */

/* Returns the quotient Q that the table holds (core/transport/table.h) at node k of panel p. */
static double quotient(const table_sample *sample, size_t i, size_t p, size_t k) {
  const size_t at = (i * PANELS + p) * NODES_X + k;
  const double x = sample->x[at];
  const double kx = transport_kappa(sample->albedo[i]) * x;
  return fn_log(x * sample->R[at] / sample->albedo[i]) + kx - fn_log(1 + kx);
}

static void put_side(struct writer *writer, double quantum, const table_sample *samples,
                     size_t nv) {
  static double values[NODES_X * NODES_T * NODES_V_MAX];
  for (size_t i = 0; i < NODES_T; i++) {
    for (size_t j = 0; j < nv; j++) {
      values[i * nv + j] = fn_log(samples[j].total[i] / samples[j].albedo[i]);
    }
  }
  put_series(writer, quantum, values, 1, NODES_T, nv);
  for (size_t p = 0; p < PANELS; p++) {
    for (size_t k = 0; k < NODES_X; k++) {
      for (size_t i = 0; i < NODES_T; i++) {
        for (size_t j = 0; j < nv; j++) {
          values[(k * NODES_T + i) * nv + j] = quotient(&samples[j], i, p, k);
        }
      }
    }
    put_series(writer, quantum, values, NODES_X, NODES_T, nv);
  }
}

uint8_t *nodes_encode(const double *field, const table_sample samples[NODES], size_t *length) {
  struct writer writer = {malloc(BYTES_MAX), TRANSPORT_TABLE_HEADER_BYTES};
  if (writer.bytes == NULL) {
    tools_fail("out of memory");
  }
  const double quantum = field[TRANSPORT_TABLE_QUANTUM];
  put_side(&writer, quantum, samples, NODES_BELOW_1);
  put_side(&writer, quantum, samples + NODES_BELOW_1, NODES_FROM_1);
  memcpy(writer.bytes, TRANSPORT_TABLE_MAGIC, 8);
  put_number(writer.bytes + 8, TRANSPORT_TABLE_VERSION, 4);
  put_number(writer.bytes + 12, writer.length, 4);
  for (size_t i = 0; i < TRANSPORT_TABLE_FIELDS; i++) {
    put_double(writer.bytes + 24 + 8 * i, field[i]);
  }
  *length = writer.length;
  return writer.bytes;
}

void nodes_seal(uint8_t *bytes, size_t length, double error) {
  put_double(bytes + 24 + 8 * TRANSPORT_TABLE_ERROR, error);
  put_number(bytes + 16, transport_table_checksum(bytes + 24, length - 24), 8);
}
