/* Makes and checks the words of core/varying/surface.h. */
#include "core/varying/surface.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/kernels.h"
#include "core/transport/functions.h"

#define CORE_REAL 64
#include "core/models/cells.h"
#include "core/models/lanes.h"

/* ---- axes ------------------------------------------------------------------------------------ */

/* A function is fitted through 4 points of each cell, at these positions. The ends are shared with
 * the neighbours, so that the cells meet. */
enum { STEPS = 3 }; /* between the points of a cell */
static const double positions[STEPS + 1] = {0, 0.25, 0.75, 1};

/* Coefficients of the powers of t for the value at each position. */
static const double lagrange[STEPS + 1][CORE_SURFACE_TERMS] = {
    {1, -19.0 / 3, 32.0 / 3, -16.0 / 3},
    {0, 8, -56.0 / 3, 32.0 / 3},
    {0, -8.0 / 3, 40.0 / 3, -32.0 / 3},
    {0, 1, -16.0 / 3, 16.0 / 3},
};

static void put_integer(float *words, size_t at, size_t value) {
  const uint32_t bits = (uint32_t)value;
  memcpy(&words[at], &bits, sizeof bits);
}

static size_t integer_at(const float *words, size_t at) {
  uint32_t bits;
  memcpy(&bits, &words[at], sizeof bits);
  return bits;
}

static size_t cells_of(const float *words, enum core_surface_axis axis) {
  return integer_at(words, (size_t)CORE_SURFACE_CELLS + axis);
}

/* Lays an axis from 2^first to 2^end, with 2^cuts[i] cells in octave i from `first` on. */
static void lay_axis(float *words, enum core_surface_axis axis, int first, int end,
                     const uint8_t *cuts) {
  size_t cell = 0;
  for (int i = 0; i < CORE_SURFACE_AXIS; i++) {
    const int octave = CORE_SURFACE_EXPONENT + i - first;
    const bool inside = octave >= 0 && octave < end - first;
    const size_t entry = (size_t)CORE_SURFACE_ENTRIES + CORE_SURFACE_AXIS * axis + (size_t)i;
    put_integer(words, entry, inside ? cell << 5 | cuts[octave] : 0);
    cell += inside ? (size_t)1 << cuts[octave] : 0;
  }
  words[CORE_SURFACE_LEAST + axis] = (float)ldexp(1, first);
  words[CORE_SURFACE_MOST + axis] = (float)(ldexp(1, end) * (1 - 0x1p-24));
  put_integer(words, (size_t)CORE_SURFACE_CELLS + axis, cell);
}

/* Sets nodes[STEPS cells + 1] to the coordinates of all points of an axis, in ascending order. */
static void axis_nodes(const float *words, enum core_surface_axis axis, double *nodes) {
  size_t node = 0;
  for (int i = 0; i < CORE_SURFACE_AXIS; i++) {
    const size_t entry =
        integer_at(words, (size_t)CORE_SURFACE_ENTRIES + CORE_SURFACE_AXIS * axis + (size_t)i);
    const double begin = ldexp(1, CORE_SURFACE_EXPONENT + i);
    const bool inside = begin >= (double)words[CORE_SURFACE_LEAST + axis] &&
                        begin < (double)words[CORE_SURFACE_MOST + axis];
    const size_t cells = inside ? (size_t)1 << (entry & 31) : 0;
    for (size_t cell = 0; cell < cells; cell++) {
      for (int step = 0; step < STEPS; step++) {
        nodes[node++] = begin * (1 + ((double)cell + positions[step]) / (double)cells);
      }
    }
    if (cells > 0) {
      nodes[node] = 2 * begin;
    }
  }
}

/* Sets the cells of a function of one coordinate to those through values[STEPS cells + 1]. */
static void fit_lines(const double *values, size_t cells, float *out) {
  for (size_t cell = 0; cell < cells; cell++) {
    for (int k = 0; k < CORE_SURFACE_TERMS; k++) {
      double sum = 0;
      for (int i = 0; i <= STEPS; i++) {
        sum += values[STEPS * cell + (size_t)i] * lagrange[i][k];
      }
      out[CORE_SURFACE_TERMS * cell + (size_t)k] = (float)sum;
    }
  }
}

/* ---- colours --------------------------------------------------------------------------------- */

enum {
  COLOUR_FIRST = -20, /* octaves of the colour, and of what is left to the largest colour */
  COLOUR_REST_FIRST = -24,
  COLOUR_END = -1,
  COLOUR_CUTS = 2,
  COLOUR_CELLS = (COLOUR_END - COLOUR_FIRST) << COLOUR_CUTS,
  COLOUR_REST_CELLS = (COLOUR_END - COLOUR_REST_FIRST) << COLOUR_CUTS,
  COLOUR_WORDS = CORE_LIGHTS * CORE_SURFACE_TERMS * (COLOUR_CELLS + COLOUR_REST_CELLS),
  SECANTS = 40
};

/* Albedos as a function of s = sqrt(sigma_a / sigma_t'), of one light. */
struct albedos {
  double (*at)(const struct albedos *albedos, double s, double w); /* w = 1 - s; falls with s */
  const double *shared;                                            /* of a dipole */
  const struct solutions *solutions;                               /* of transport */
  enum core_light light;
};

static double dipole_albedo(const struct albedos *albedos, double s, double w) {
  const struct lane lane = {1, 1, s * s, w * (1 + s)};
  const struct lane_dipole dipole = lane_dipole_of(albedos->shared, lane);
  return 0.5 * dipole.power * dipole.sum;
}

/* Returns the logarithm of the albedo of the medium w = e^y, or of what it lacks to `most` if
 * `rest`, of the medium s = e^y. */
static double ln_albedo(const struct albedos *albedos, double most, bool rest, double y) {
  const double x = fn_exp(y);
  const double albedo = rest ? albedos->at(albedos, x, 1 - x) : albedos->at(albedos, 1 - x, x);
  return fn_log(fmax(rest ? most - albedo : albedo, 1e-300));
}

/* Returns the y at which ln_albedo() is `wanted`, by the secant method from y on: the function is
 * nearly a straight line of slope 1 or 2. */
static double find_medium(const struct albedos *albedos, double most, bool rest, double wanted,
                          double y) {
  double before = y - 0.01, off_before = ln_albedo(albedos, most, rest, before) - wanted;
  for (int i = 0; i < SECANTS; i++) {
    const double off = ln_albedo(albedos, most, rest, y) - wanted;
    const double slope = (off - off_before) / (y - before);
    if (fabs(off) < 1e-13 || !(slope > 0.1)) {
      break;
    }
    before = y;
    off_before = off;
    y = fmin(y - off / slope, 0);
  }
  return y;
}

static void fit_colours(const struct albedos *albedos, double most, float *words, size_t *at) {
  double nodes[STEPS * COLOUR_REST_CELLS + 1], values[STEPS * COLOUR_REST_CELLS + 1];
  for (int rest = 0; rest < 2; rest++) {
    const size_t cells = rest ? COLOUR_REST_CELLS : COLOUR_CELLS;
    axis_nodes(words, rest ? CORE_SURFACE_COLOUR_REST : CORE_SURFACE_COLOUR, nodes);
    double y = fn_log(0.7); /* of about half of the largest albedo */
    for (size_t i = STEPS * cells + 1; i-- > 0;) {
      y = find_medium(albedos, most, rest, fn_log(most * nodes[i]), y);
      values[i] = fn_exp(y);
    }
    fit_lines(values, cells, &words[*at]);
    const enum core_surface_function function =
        rest ? CORE_SURFACE_S_OF_REST : CORE_SURFACE_W_OF_COLOUR;
    put_integer(words, (size_t)CORE_SURFACE_AT + function + albedos->light, *at);
    *at += CORE_SURFACE_TERMS * cells;
  }
}

/* Makes the functions of colours for the light of `albedos`. */
static void put_colours(const struct albedos *albedos, double most, float *words, size_t *at) {
  words[CORE_SURFACE_COLOUR_MOST + albedos->light] = (float)most;
  words[CORE_SURFACE_COLOUR_LEAST + albedos->light] = (float)(most * ldexp(1, COLOUR_FIRST));
  fit_colours(albedos, most, words, at);
}

static void lay_colour_axes(float *words) {
  uint8_t cuts[CORE_SURFACE_AXIS];
  memset(cuts, COLOUR_CUTS, sizeof cuts);
  lay_axis(words, CORE_SURFACE_COLOUR, COLOUR_FIRST, COLOUR_END, cuts);
  lay_axis(words, CORE_SURFACE_COLOUR_REST, COLOUR_REST_FIRST, COLOUR_END, cuts);
}

core_fault core_surface_build(const core_surface_inputs *inputs, float **words, size_t *count) {
  *count = CORE_SURFACE_PATCHES + COLOUR_WORDS;
  *words = calloc(*count, sizeof **words);
  if (*words == NULL) {
    return CORE_OUT_OF_MEMORY;
  }
  size_t at = CORE_SURFACE_PATCHES;
  put_integer(*words, CORE_SURFACE_VERSION_WORD, CORE_SURFACE_VERSION);
  lay_colour_axes(*words);
  const struct albedos albedos = {dipole_albedo, inputs->shared, NULL, CORE_LIGHT_BEAM};
  put_colours(&albedos, dipole_albedo(&albedos, 0, 1), *words, &at);
  *count = at;
  return (core_fault){0};
}

/* ---- checking -------------------------------------------------------------------------------- */

/* Whether an axis has `cells` cells in turn, from its least to its most coordinate. */
static bool axis_good(const float *words, enum core_surface_axis axis, size_t most_cells) {
  const float least = words[CORE_SURFACE_LEAST + axis], most = words[CORE_SURFACE_MOST + axis];
  int first, end;
  if (!(least > 0 && least < most && most < (float)INFINITY) || frexpf(least, &first) > 0.5f) {
    return false;
  }
  frexpf(most, &end);
  first = first - 1 - CORE_SURFACE_EXPONENT;
  end = end - CORE_SURFACE_EXPONENT;
  size_t cells = 0;
  bool good = first >= 0 && end <= CORE_SURFACE_AXIS;
  for (int i = first; good && i < end; i++) {
    const size_t entry =
        integer_at(words, (size_t)CORE_SURFACE_ENTRIES + CORE_SURFACE_AXIS * axis + (size_t)i);
    good = entry >> 5 == cells && (entry & 31) <= CORE_SURFACE_CUTS_MAX;
    cells += good ? (size_t)1 << (entry & 31) : 0;
  }
  return good && cells == cells_of(words, axis) && cells <= most_cells;
}

/* The axes of each function; the first two share their rows. */
static const struct {
  bool of_transport;
  bool has_rows;
  enum core_surface_axis columns;
} shapes[CORE_SURFACE_FUNCTIONS] = {
    [CORE_SURFACE_Q] = {true, true, CORE_SURFACE_RADIUS},
    [CORE_SURFACE_CDF] = {true, true, CORE_SURFACE_RADIUS},
    [CORE_SURFACE_X_OF_U] = {true, true, CORE_SURFACE_U},
    [CORE_SURFACE_X_OF_REST] = {true, true, CORE_SURFACE_REST},
    [CORE_SURFACE_TOTAL] = {true, true, CORE_SURFACE_AXES},
    [CORE_SURFACE_W_OF_COLOUR + CORE_LIGHT_BEAM] = {false, false, CORE_SURFACE_COLOUR},
    [CORE_SURFACE_W_OF_COLOUR + CORE_LIGHT_DIFFUSE] = {true, false, CORE_SURFACE_COLOUR},
    [CORE_SURFACE_S_OF_REST + CORE_LIGHT_BEAM] = {false, false, CORE_SURFACE_COLOUR_REST},
    [CORE_SURFACE_S_OF_REST + CORE_LIGHT_DIFFUSE] = {true, false, CORE_SURFACE_COLOUR_REST},
};

/* Returns the number of words of a function. */
static size_t words_of(const float *words, enum core_surface_function function) {
  const size_t rows = shapes[function].has_rows
                          ? cells_of(words, CORE_SURFACE_S) + cells_of(words, CORE_SURFACE_W)
                          : 1;
  const bool line = !shapes[function].has_rows || shapes[function].columns == CORE_SURFACE_AXES;
  const size_t columns =
      shapes[function].columns == CORE_SURFACE_AXES ? 1 : cells_of(words, shapes[function].columns);
  return rows * columns * (line ? CORE_SURFACE_TERMS : CORE_SURFACE_TERMS * CORE_SURFACE_TERMS);
}

core_fault core_surface_check(const float *words, size_t count, bool is_transport) {
  bool good = count >= CORE_SURFACE_PATCHES && count <= INT32_MAX &&
              integer_at(words, CORE_SURFACE_VERSION_WORD) == CORE_SURFACE_VERSION;
  for (int axis = is_transport ? 0 : CORE_SURFACE_COLOUR; good && axis < CORE_SURFACE_AXES;
       axis++) {
    good = axis_good(words, axis, count / CORE_SURFACE_TERMS);
  }
  for (int i = 0; good && i < CORE_SURFACE_FUNCTIONS; i++) {
    if (is_transport || !shapes[i].of_transport) {
      const size_t at = integer_at(words, (size_t)CORE_SURFACE_AT + (size_t)i);
      good = at >= CORE_SURFACE_PATCHES && at <= count && words_of(words, i) <= count - at;
    }
  }
  return good ? (core_fault){0}
              : (core_fault){"table", "the words of a preparation of this model", 0};
}
