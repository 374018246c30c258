/* Makes and checks the words of core/varying/surface.h. */
#include "core/varying/surface.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/kernels.h"
#include "core/transport/functions.h"
#include "core/transport/table.h"
#include "core/varying/rows.h"

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
  const size_t lines = shapes[function].has_rows
                           ? cells_of(words, CORE_SURFACE_S) + cells_of(words, CORE_SURFACE_W)
                           : 1;
  const bool line = !shapes[function].has_rows || shapes[function].columns == CORE_SURFACE_AXES;
  const size_t columns =
      shapes[function].columns == CORE_SURFACE_AXES ? 1 : cells_of(words, shapes[function].columns);
  return lines * columns * (line ? CORE_SURFACE_TERMS : CORE_SURFACE_TERMS * CORE_SURFACE_TERMS);
}

/* ---- colours --------------------------------------------------------------------------------- */

enum {
  COLOUR_FIRST = -20, /* octaves of the colour, and of what is left to the largest colour */
  COLOUR_REST_FIRST = -24,
  COLOUR_END = -1,
  COLOUR_CUTS = 2,
  COLOUR_FINE = 2, /* octaves at the end, with more cuts: dark media of a large eta bend there */
  COLOUR_FINE_CUTS = 4,
  COLOUR_FINE_MORE = (COLOUR_FINE << COLOUR_FINE_CUTS) - (COLOUR_FINE << COLOUR_CUTS),
  COLOUR_CELLS = ((COLOUR_END - COLOUR_FIRST) << COLOUR_CUTS) + COLOUR_FINE_MORE,
  COLOUR_REST_CELLS = ((COLOUR_END - COLOUR_REST_FIRST) << COLOUR_CUTS) + COLOUR_FINE_MORE,
  COLOUR_WORDS = CORE_LIGHTS * CORE_SURFACE_TERMS * (COLOUR_CELLS + COLOUR_REST_CELLS),
  SECANTS = 40
};

/* Albedos as a function of s = sqrt(sigma_a / sigma_t'), of one light. */
struct albedos {
  double (*at)(const struct albedos *albedos, double s, double w); /* w = 1 - s; falls with s */
  const double *shared;                                            /* of a dipole */
  const rows *rows;                                                /* of transport */
  enum core_light light;
};

static double transport_albedo(const struct albedos *albedos, double s, double w) {
  const transport_slice_sums totals =
      rows_totals(albedos->rows, s, fmax(w, rows_w_least(albedos->rows)));
  return albedos->light == CORE_LIGHT_BEAM ? totals.beam : totals.diffuse;
}

static double dipole_albedo(const struct albedos *albedos, double s, double w) {
  const struct lane lane = {s * s, 1, 1, s * s, w * (1 + s)};
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

/* Returns the y at which ln_albedo() is `wanted`, by the secant method from y on: the function rises,
 * and is nearly a straight line of slope 1 or 2. What the albedo lacks hardly changes where the
 * albedo is small, as in dark media with a large eta: a step that leads out of the bracket halves
 * it. */
static double find_medium(const struct albedos *albedos, double most, bool rest, double wanted,
                          double y) {
  double before = y - 0.01, off_before = ln_albedo(albedos, most, rest, before) - wanted;
  double low = -40, high = 0;
  for (int i = 0; i < SECANTS; i++) {
    const double off = ln_albedo(albedos, most, rest, y) - wanted;
    const double slope = (off - off_before) / (y - before);
    if (fabs(off) < 1e-13 || (!rest && !(slope > 0.1))) { /* or below the least albedo */
      break;
    }
    low = off < 0 ? y : low;
    high = off > 0 ? y : high;
    before = y;
    off_before = off;
    const double next = y - off / slope;
    y = next > low && next < high ? next : 0.5 * (low + high);
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
  for (int rest = 0; rest < 2; rest++) {
    const int first = rest ? COLOUR_REST_FIRST : COLOUR_FIRST;
    uint8_t cuts[CORE_SURFACE_AXIS];
    memset(cuts, COLOUR_CUTS, sizeof cuts);
    memset(&cuts[COLOUR_END - first - COLOUR_FINE], COLOUR_FINE_CUTS, COLOUR_FINE);
    lay_axis(words, rest ? CORE_SURFACE_COLOUR_REST : CORE_SURFACE_COLOUR, first, COLOUR_END, cuts);
  }
}

/* ---- the surface ----------------------------------------------------------------------------- */

enum {
  S_FIRST = -17, /* octaves of each axis; that of s begins here or below: see first_of_s() */
  W_FIRST = -8,
  ALBEDO_END = -1,
  U_FIRST = -20,
  REST_FIRST = -24,
  U_END = -1,
  FINE_LEVEL = 2, /* the first one for tolerances below 2e-5 */
  LEVELS = 4
};

/* The cells of an octave of radii, as powers of two. Q has a kink at each fixed edge of the table's
 * series: octaves whose cells do not meet there get narrow ones. */
static int cuts_of_radius(const transport_table *table, int octave, int level) {
  /* Single scattering gives way to multiple near x = 8; the series for g end near x = 100. */
  const int base = octave < -1 ? 0 : octave == 0 ? 3 : octave > 0 && octave < 8 ? 2 : 1;
  const bool bends = octave == 3 || (octave > 4 && octave < 8 && level > 0);
  int cuts = base + (octave < -11 ? 0 : level) + bends;
  for (int i = 0; i <= TRANSPORT_TABLE_NEAR + 1 + TRANSPORT_TABLE_D_NEAR; i++) {
    const double edge = table->field[i <= TRANSPORT_TABLE_NEAR
                                         ? TRANSPORT_TABLE_EDGES + i
                                         : TRANSPORT_TABLE_D_EDGES + i - TRANSPORT_TABLE_NEAR - 1];
    const double place = ldexp(edge, -octave); /* in units of the octave's begin */
    const double cell = ldexp(place - 1, cuts);
    if (place > 1 && place < 2 && fabs(cell - floor(cell + 0.5)) > 1e-6) {
      cuts = cuts > 1 + 3 * level ? cuts : 1 + 3 * level;
    }
  }
  /* The reach of the difference moves with the albedo, from here on inwards, and has a kink, too. */
  const double reach = table->field[TRANSPORT_TABLE_D_REACH_MOST];
  if (level >= FINE_LEVEL && ldexp(1, octave) < reach && reach <= ldexp(1, octave + 1)) {
    cuts = CORE_SURFACE_CUTS_MAX;
  }
  return cuts < CORE_SURFACE_CUTS_MAX ? cuts : CORE_SURFACE_CUTS_MAX;
}

/* The same for the other axes. Each level has one cut more, which divides errors by 16. All that
 * media have up to 2^reach is nearly a straight line of s below 2^-reach. */
static int cuts_of(enum core_surface_axis axis, int octave, int reach, int level) {
  int base;
  if (axis == CORE_SURFACE_W) { /* the first octave is not full: see fill_rows() */
    base = octave == W_FIRST || octave == ALBEDO_END - 1 ? 2 : 1;
  } else if (axis == CORE_SURFACE_S) {
    base = octave + reach < -2 ? 0 : octave < -4 ? 1 : 2;
    level = octave + reach < -4 ? 0 : level;
  } else {
    base = octave >= -4 ? 2 : octave == -5 || axis == CORE_SURFACE_REST;
  }
  return base + level;
}

/* Returns the first octave of s. Media that do not absorb, too, get the functions of the least s:
 * what they are off by is some 2 s x, at the reach x a small share of the tolerance. */
static int first_of_s(double reach, double tolerance) {
  int end;
  frexp(0.03 * tolerance / reach, &end);
  end = end < S_FIRST + 1 ? end : S_FIRST + 1;
  return end - 1 > CORE_SURFACE_EXPONENT ? end - 1 : CORE_SURFACE_EXPONENT;
}

static void lay_axes(const core_surface_inputs *inputs, const transport_table *table, float *words,
                     int level) {
  const core_medium white = {0, 1 / (1 - inputs->g), inputs->g, inputs->eta};
  const double reach = core_transport_reach(&white).most_mm;
  int reach_end;
  frexp(reach, &reach_end);
  const struct {
    enum core_surface_axis axis;
    int first, end;
  } ranges[] = {
      {CORE_SURFACE_S, first_of_s(reach, inputs->tolerance), ALBEDO_END},
      {CORE_SURFACE_W, W_FIRST, ALBEDO_END},
      {CORE_SURFACE_RADIUS, ROWS_FIRST, ROWS_END},
      {CORE_SURFACE_U, U_FIRST, U_END},
      {CORE_SURFACE_REST, REST_FIRST, U_END},
  };
  for (size_t i = 0; i < sizeof ranges / sizeof ranges[0]; i++) {
    uint8_t cuts[CORE_SURFACE_AXIS];
    for (int octave = ranges[i].first; octave < ranges[i].end; octave++) {
      cuts[octave - ranges[i].first] =
          (uint8_t)(ranges[i].axis == CORE_SURFACE_RADIUS
                        ? cuts_of_radius(table, octave, level)
                        : cuts_of(ranges[i].axis, octave, reach_end, level));
    }
    lay_axis(words, ranges[i].axis, ranges[i].first, ranges[i].end, cuts);
  }
}

/* Sets the words of k: the polynomial through kappa / s at Chebyshev points. */
static void put_kappa(const rows *all, float *words) {
  enum { TERMS = CORE_SURFACE_KAPPA_TERMS };
  double sum[TERMS] = {0};
  double at[TERMS];
  for (int i = 0; i < TERMS; i++) {
    double sine, cosine;
    fn_sincos(FN_PI * (i + 0.5) / TERMS, &sine, &cosine);
    at[i] = 0.5 * (1 + cosine);
  }
  for (int i = 0; i < TERMS; i++) {
    double basis[TERMS] = {rows_kappa_per_s(all, at[i], 1 - at[i])};
    for (int k = 0, degree = 0; k < TERMS; k++) {
      if (k != i) { /* times (s - at[k]) / (at[i] - at[k]) */
        degree++;
        for (int j = degree; j >= 0; j--) {
          basis[j] = ((j > 0 ? basis[j - 1] : 0) - at[k] * basis[j]) / (at[i] - at[k]);
        }
      }
    }
    for (int j = 0; j < TERMS; j++) {
      sum[j] += basis[j];
    }
  }
  for (int j = 0; j < TERMS; j++) {
    words[CORE_SURFACE_KAPPA + j] = (float)sum[j];
  }
}

/* Sets Q[i] to Q with the k of the words in place of the exact kappa. */
static void Q_of_words(const float *words, const rows_row *row, size_t n, const double *x,
                       const double *ln_x, double *Q) {
  double k = 0;
  for (int i = CORE_SURFACE_KAPPA_TERMS - 1; i >= 0; i--) {
    k = (double)words[CORE_SURFACE_KAPPA + i] + row->s * k;
  }
  k *= row->s;
  rows_Q(row, n, ln_x, Q);
  for (size_t i = 0; i < n; i++) {
    Q[i] += (k - row->kappa) * x[i] + fn_log((1 + row->kappa * x[i]) / (1 + k * x[i]));
  }
}

/* The points of all axes, and the values of a function at the points of all rows. */
struct grid {
  double *nodes[CORE_SURFACE_AXES]; /* STEPS cells + 1 for each axis */
  double *ln_x;                     /* logarithms of those of radii */
  double *values[CORE_SURFACE_FUNCTIONS];
};

static size_t nodes_of(const float *words, enum core_surface_axis axis) {
  return STEPS * cells_of(words, axis) + 1;
}

/* Sets the values of a row, number `index` of all. */
static void set_values(const float *words, const struct grid *grid, const rows_row *row,
                       size_t index) {
  const double *x = grid->nodes[CORE_SURFACE_RADIUS];
  const size_t radii = nodes_of(words, CORE_SURFACE_RADIUS);
  Q_of_words(words, row, radii, x, grid->ln_x, &grid->values[CORE_SURFACE_Q][index * radii]);
  for (size_t i = 0; i < radii; i++) {
    grid->values[CORE_SURFACE_CDF][index * radii + i] = rows_cdf(row, x[i]);
  }
  const size_t us = nodes_of(words, CORE_SURFACE_U), rests = nodes_of(words, CORE_SURFACE_REST);
  rows_found found = {0};
  for (size_t i = 0; i < us; i++) {
    grid->values[CORE_SURFACE_X_OF_U][index * us + i] =
        rows_radius(row, grid->nodes[CORE_SURFACE_U][i], &found);
  }
  found = (rows_found){0};
  for (size_t i = 0; i < rests; i++) {
    grid->values[CORE_SURFACE_X_OF_REST][index * rests + i] =
        rows_radius_of_rest(row, grid->nodes[CORE_SURFACE_REST][i], &found);
  }
  grid->values[CORE_SURFACE_TOTAL][index] = row->total;
}

/* Sets the patches of `cells` rows of cells. */
static void fit_patches(const double *values, size_t cells, size_t columns, float *out) {
  const size_t count = STEPS * columns + 1;
  for (size_t patch = 0; patch < cells * columns; patch++) {
    const double *corner = &values[STEPS * (patch / columns) * count + STEPS * (patch % columns)];
    double along[STEPS + 1][CORE_SURFACE_TERMS]; /* powers of t, at each position of the rows */
    for (int i = 0; i <= STEPS; i++) {
      for (int q = 0; q < CORE_SURFACE_TERMS; q++) {
        double sum = 0;
        for (int k = 0; k <= STEPS; k++) {
          sum += lagrange[k][q] * corner[(size_t)i * count + (size_t)k];
        }
        along[i][q] = sum;
      }
    }
    for (int p = 0; p < CORE_SURFACE_TERMS; p++) {
      for (int q = 0; q < CORE_SURFACE_TERMS; q++) {
        double sum = 0;
        for (int i = 0; i <= STEPS; i++) {
          sum += lagrange[i][p] * along[i][q];
        }
        out[16 * patch + (size_t)(4 * p + q)] = (float)sum;
      }
    }
  }
}

/* Sets the words of all functions of a surface from the values. */
static void put_functions(const struct grid *grid, float *words, size_t *at) {
  const size_t s_cells = cells_of(words, CORE_SURFACE_S), w_cells = cells_of(words, CORE_SURFACE_W);
  for (int i = 0; i <= CORE_SURFACE_X_OF_REST; i++) {
    const size_t columns = cells_of(words, shapes[i].columns), count = STEPS * columns + 1;
    put_integer(words, (size_t)CORE_SURFACE_AT + (size_t)i, *at);
    fit_patches(grid->values[i], s_cells, columns, &words[*at]);
    *at += 16 * s_cells * columns;
    fit_patches(&grid->values[i][(STEPS * s_cells + 1) * count], w_cells, columns, &words[*at]);
    *at += 16 * w_cells * columns;
  }
  put_integer(words, (size_t)CORE_SURFACE_AT + CORE_SURFACE_TOTAL, *at);
  fit_lines(grid->values[CORE_SURFACE_TOTAL], s_cells, &words[*at]);
  *at += CORE_SURFACE_TERMS * s_cells;
  fit_lines(&grid->values[CORE_SURFACE_TOTAL][STEPS * s_cells + 1], w_cells, &words[*at]);
  *at += CORE_SURFACE_TERMS * w_cells;
}

/* ---- measuring ------------------------------------------------------------------------------- */

/* The stated error is the one found in the middle of cells, and of R at kinks, times this. */
#define FOUND_MARGIN 1.2

enum { MEASURED = 256 };

/* One row of a surface that is measured. */
struct measured {
  const double *shared;
  const float *words;
  const double *wide; /* the words in double precision */
  const struct grid *grid;
  const rows_row *row;
};

/* Sets exact[i] to the value of a function at in[i], in ascending order. */
static void row_values(const rows_row *row, enum core_surface_function function, size_t n,
                       const double *in, double *exact) {
  rows_found found = {0};
  double ln_x[MEASURED] = {0};
  for (size_t i = 0; i < n; i++) {
    ln_x[i] = function == CORE_SURFACE_Q ? fn_log(in[i]) : 0;
    exact[i] = function == CORE_SURFACE_CDF      ? rows_cdf(row, in[i])
               : function == CORE_SURFACE_X_OF_U ? rows_radius(row, in[i], &found)
                                                 : 0;
    if (function == CORE_SURFACE_X_OF_REST) {
      exact[i] = rows_radius_of_rest(row, in[i], &found);
    }
  }
  if (function == CORE_SURFACE_Q) {
    rows_Q(row, n, ln_x, exact);
    for (size_t i = 0; i < n; i++) {
      const double kx = row->kappa * in[i];
      exact[i] = row->albedo * (1 + kx) / in[i] * fn_exp(exact[i] - kx);
    }
  }
}

/* Sets x to the middle of cell number `first` of an axis and of those that follow. */
static void middles(const struct grid *grid, enum core_surface_axis axis, size_t first,
                    size_t count, double *x) {
  for (size_t i = 0; i < count; i++) {
    const double *node = &grid->nodes[axis][STEPS * (first + i)];
    x[i] = 0.5 * (node[1] + node[2]);
  }
}

/* Returns the largest relative error of a function at `count` places, for one row, up to the reach.
 */
static double measure_at(const struct measured *of, enum core_surface_function function,
                         core_varying_kernel_f64 *kernel, size_t count, const double *places) {
  const rows_row *row = of->row;
  const float *far = &of->words[CORE_SURFACE_FAR];
  const double reach = 1 / ((double)far[0] + row->s * ((double)far[1] + row->s * (double)far[2]));
  double sigma_a[MEASURED] = {0}, sigma_s[MEASURED] = {0}, in[MEASURED] = {0};
  double found[MEASURED], exact[MEASURED];
  double worst = 0;
  row_values(row, function, count, places, exact);
  for (size_t i = 0; i < count; i++) {
    sigma_a[i] = row->s * row->s;
    sigma_s[i] = row->albedo / of->shared[LANES_SCATTER];
    in[i] = function == CORE_SURFACE_X_OF_REST ? 1 - places[i] : places[i];
  }
  kernel(of->shared, of->wide, count, sigma_a, sigma_s, in, found);
  for (size_t i = 0; i < count; i++) {
    const double r = shapes[function].columns == CORE_SURFACE_RADIUS ? places[i] : exact[i];
    worst = r <= reach ? fmax(worst, fabs(found[i] / exact[i] - 1)) : worst;
  }
  return worst;
}

/* Returns the largest error of a function for one row: in the middle of cells, and at kinks of Q. */
static double measure_function(const struct measured *of, enum core_surface_function function,
                               core_varying_kernel_f64 *kernel) {
  const enum core_surface_axis axis = shapes[function].columns;
  const size_t cells = cells_of(of->words, axis);
  double places[MEASURED];
  double worst = 0;
  for (size_t begin = 0; begin < cells; begin += MEASURED) {
    const size_t count = cells - begin < MEASURED ? cells - begin : MEASURED;
    middles(of->grid, axis, begin, count, places);
    worst = fmax(worst, measure_at(of, function, kernel, count, places));
  }
  if (function == CORE_SURFACE_Q) {
    const size_t count = rows_edges(of->row, places);
    worst = fmax(worst, measure_at(of, function, kernel, count, places));
  }
  return worst;
}

/* Returns the error of the total that the pdf is divided by. */
static double measure_total(const struct measured *of, const core_kernels_f64 *kernels) {
  const double sigma_a = of->row->s * of->row->s;
  const double sigma_s = of->row->albedo / of->shared[LANES_SCATTER];
  double total;
  kernels->varying_albedo(of->shared, of->wide, 1, &sigma_a, &sigma_s, &sigma_a, &total);
  return fabs(total / of->row->total - 1);
}

/* Returns the largest error of all functions for one row; the pdf has that of R and of the total. */
static double measure_row(const struct measured *of, const core_kernels_f64 *kernels) {
  double worst = 0;
  for (int i = 0; i <= CORE_SURFACE_X_OF_REST; i++) {
    core_varying_kernel_f64 *kernel = i == CORE_SURFACE_Q ? kernels->varying[CORE_ELEMENTWISE_R]
                                      : i == CORE_SURFACE_CDF
                                          ? kernels->varying[CORE_ELEMENTWISE_CDF]
                                          : kernels->varying_sample;
    worst = fmax(worst, measure_function(of, i, kernel));
  }
  return worst + measure_total(of, kernels);
}

/* ---- all words ------------------------------------------------------------------------------- */

/* Sets the words of the reach, such that it is nowhere beyond that of core_transport_reach(). */
static void put_far(const core_surface_inputs *inputs, float *words) {
  const double slack = 1 + 0x1p-20; /* for rounding to single precision */
  double far[3] = {0};
  for (int power = 0; power < 3; power++) {
    for (int i = 0; i <= 64; i++) {
      const double s = i / 64.0 * 0.995;
      const core_medium medium = {s * s, (1 - s) * (1 + s) / (1 - inputs->g), inputs->g,
                                  inputs->eta};
      const double wanted = slack / core_transport_reach(&medium).most_mm;
      const double rest = wanted - (far[0] + s * (far[1] + s * far[2]));
      if ((power == 0 && i == 0) || (power == 1 && i > 0 && i <= 40) || (power == 2 && i > 0)) {
        far[power] += fmax(rest, 0) / (power == 0 ? 1 : power == 1 ? s : s * s);
      }
    }
    words[CORE_SURFACE_FAR + power] = (float)(far[power] * slack);
  }
}

/* Number of points of both axes of albedos. */
static size_t rows_of(const float *words) {
  return nodes_of(words, CORE_SURFACE_S) + nodes_of(words, CORE_SURFACE_W);
}

static void free_grid(struct grid *grid) {
  free(grid->ln_x);
  for (int i = 0; i < CORE_SURFACE_AXES; i++) {
    free(grid->nodes[i]);
  }
  for (int i = 0; i < CORE_SURFACE_FUNCTIONS; i++) {
    free(grid->values[i]);
  }
}

static bool make_grid(const float *words, struct grid *grid) {
  *grid = (struct grid){.ln_x = malloc(nodes_of(words, CORE_SURFACE_RADIUS) * sizeof(double))};
  bool good = grid->ln_x != NULL;
  for (int i = 0; i < CORE_SURFACE_COLOUR; i++) {
    grid->nodes[i] = malloc(nodes_of(words, i) * sizeof(double));
    good = good && grid->nodes[i] != NULL;
  }
  for (int i = 0; i <= CORE_SURFACE_TOTAL; i++) {
    const size_t columns =
        shapes[i].columns == CORE_SURFACE_AXES ? 1 : nodes_of(words, shapes[i].columns);
    grid->values[i] = malloc(rows_of(words) * columns * sizeof(double));
    good = good && grid->values[i] != NULL;
  }
  for (int i = 0; good && i < CORE_SURFACE_COLOUR; i++) {
    axis_nodes(words, i, grid->nodes[i]);
  }
  for (size_t i = 0; good && i < nodes_of(words, CORE_SURFACE_RADIUS); i++) {
    grid->ln_x[i] = fn_log(grid->nodes[CORE_SURFACE_RADIUS][i]);
  }
  return good;
}

/* Fills the rows of an axis of albedos; `first` is the number of the first one. */
static void fill_rows(const rows *all, const float *words, const struct grid *grid,
                      enum core_surface_axis axis, size_t first, rows_row *row) {
  for (size_t i = 0; i < nodes_of(words, axis); i++) {
    const double node = grid->nodes[axis][i];
    const bool by_s = axis == CORE_SURFACE_S;
    /* Rows far below the least albedo only fill up the first octave. */
    const double w = fmax(by_s ? 1 - node : node, 0.95 * rows_w_least(all));
    rows_fill(all, by_s ? node : 1 - w, w, row);
    set_values(words, grid, row, first + i);
  }
}

/* Returns the largest error in the middle of cells of both axes of albedos, and without absorption.
 */
static double measure(const core_surface_inputs *inputs, const rows *all, const float *words,
                      size_t count, const struct grid *grid, rows_row *row) {
  double *wide = core_surface_widen(words, count);
  const struct measured of = {inputs->shared, words, wide, grid, row};
  const core_kernels_f64 *kernels = core_isa_surface_kernels(inputs->isa)->f64;
  double worst = (double)INFINITY;
  if (wide != NULL) {
    rows_fill(all, 0, 1, row);
    worst = measure_row(&of, kernels);
  }
  for (int axis = CORE_SURFACE_S; wide != NULL && axis <= CORE_SURFACE_W; axis++) {
    for (size_t i = 0; i < cells_of(words, axis); i++) {
      const double middle =
          0.5 * (grid->nodes[axis][STEPS * i + 1] + grid->nodes[axis][STEPS * i + 2]);
      const double w = axis == CORE_SURFACE_S ? 1 - middle : middle;
      if (w >= rows_w_least(all)) {
        rows_fill(all, axis == CORE_SURFACE_S ? middle : 1 - middle, w, row);
        worst = fmax(worst, measure_row(&of, kernels));
      }
    }
  }
  free(wide);
  return worst;
}

static void put_all_colours(const rows *all, const double *shared, float *words, size_t *at) {
  for (int light = 0; light < (all != NULL ? CORE_LIGHTS : 1); light++) {
    const struct albedos albedos = {all != NULL ? transport_albedo : dipole_albedo, shared, all,
                                    light};
    const double most = all != NULL ? 1 : dipole_albedo(&albedos, 0, 1);
    put_colours(&albedos, most, words, at);
    if (all != NULL) {
      const double w = rows_w_least(all);
      words[CORE_SURFACE_COLOUR_LEAST + light] = (float)(transport_albedo(&albedos, 1 - w, w));
    }
  }
}

/* Makes the words of a surface, from a header that holds the axes. */
static core_fault build_surface(const core_surface_inputs *inputs, const rows *all, rows_row *row,
                                const float *header, float **words, size_t *count) {
  struct grid grid;
  *count = CORE_SURFACE_PATCHES;
  for (int i = 0; i < CORE_SURFACE_FUNCTIONS; i++) {
    *count += words_of(header, i);
  }
  *words = calloc(*count, sizeof **words);
  if (!make_grid(header, &grid) || *words == NULL) {
    free_grid(&grid);
    free(*words);
    return CORE_OUT_OF_MEMORY;
  }
  memcpy(*words, header, CORE_SURFACE_PATCHES * sizeof *header);
  put_kappa(all, *words);
  put_far(inputs, *words);
  fill_rows(all, *words, &grid, CORE_SURFACE_S, 0, row);
  fill_rows(all, *words, &grid, CORE_SURFACE_W, nodes_of(header, CORE_SURFACE_S), row);
  size_t at = CORE_SURFACE_PATCHES;
  put_functions(&grid, *words, &at);
  put_all_colours(all, NULL, *words, &at);
  (*words)[CORE_SURFACE_SCATTERED_LEAST] =
      (float)(rows_w_least(all) * (2 - rows_w_least(all)) * (1 + 0x1p-20));
  (*words)[CORE_SURFACE_ERROR] =
      (float)(FOUND_MARGIN * measure(inputs, all, *words, *count, &grid, row) + rows_error(all));
  free_grid(&grid);
  return (core_fault){0};
}

/* Makes surfaces with more and more cells until one is within the tolerance. */
static core_fault build_transport(const core_surface_inputs *inputs, float *header, float **words,
                                  size_t *count) {
  const transport_table *table = transport_table_shipped();
  if (table == NULL || !transport_table_covers(table, 0.5, inputs->g, inputs->eta)) {
    return (core_fault){"eta", "0.7 to 2.2 if media vary", 0};
  }
  rows *all = rows_create(table, inputs->g, inputs->eta, inputs->tolerance);
  rows_row *row = malloc(sizeof *row);
  core_fault fault = all == NULL || row == NULL ? CORE_OUT_OF_MEMORY : (core_fault){0};
  int level = inputs->tolerance >= 3e-4 ? 0 : inputs->tolerance >= 2e-5 ? 1 : FINE_LEVEL;
  bool good = false;
  while (fault.field == NULL && !good) {
    lay_axes(inputs, table, header, level);
    fault = build_surface(inputs, all, row, header, words, count);
    good = fault.field == NULL && (double)(*words)[CORE_SURFACE_ERROR] <= inputs->tolerance;
    level++;
    if (fault.field == NULL && !good && level == LEVELS) {
      fault = (core_fault){"tolerance", "a larger one, for transport with this g", 0};
    }
    if (fault.field == NULL && !good) {
      free(*words);
    }
  }
  rows_free(all);
  free(row);
  return fault;
}

core_fault core_surface_build(const core_surface_inputs *inputs, float **words, size_t *count) {
  float header[CORE_SURFACE_PATCHES] = {0};
  put_integer(header, CORE_SURFACE_VERSION_WORD, CORE_SURFACE_VERSION);
  lay_colour_axes(header);
  if (inputs->is_transport) {
    return build_transport(inputs, header, words, count);
  }
  *count = CORE_SURFACE_PATCHES + COLOUR_WORDS / CORE_LIGHTS;
  *words = malloc(*count * sizeof **words);
  if (*words == NULL) {
    return CORE_OUT_OF_MEMORY;
  }
  memcpy(*words, header, sizeof header);
  size_t at = CORE_SURFACE_PATCHES;
  put_all_colours(NULL, inputs->shared, *words, &at);
  return (core_fault){0};
}

double *core_surface_widen(const float *words, size_t count) {
  double *wide = malloc(count * sizeof *wide);
  for (size_t i = 0; wide != NULL && i < count; i++) {
    const bool integer = i < CORE_SURFACE_LEAST ||
                         (i >= CORE_SURFACE_CELLS && i < CORE_SURFACE_KAPPA) ||
                         (i >= CORE_SURFACE_ENTRIES && i < CORE_SURFACE_PATCHES);
    const int64_t bits = (int64_t)integer_at(words, i);
    if (integer) {
      memcpy(&wide[i], &bits, sizeof bits);
    } else {
      wide[i] = (double)words[i];
    }
  }
  return wide;
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
