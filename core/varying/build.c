/* Makes the words of a surface, and checks words that others have made. core/varying/surface.h
 * describes them. */
#include "core/varying/surface.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/cells/cells.h"
#include "core/kernels.h"
#include "core/transport/functions.h"
#include "core/transport/table.h"
#include "core/varying/rows.h"

#define CORE_REAL 64
#include "core/models/lanes.h"

enum { STEPS = CORE_CELLS_STEPS, TERMS = CORE_CELLS_TERMS, PATCH = CORE_CELLS_PATCH };

/* ---- axes ------------------------------------------------------------------------------------ */

static void put_integer(float *words, size_t at, size_t value) {
  words[at] = core_cells_float((uint32_t)value);
}

static uint32_t integer_at(const float *words, size_t at) {
  return core_cells_bits(words[at]);
}

/* Returns the entry of octave i of an axis. Octave 0 begins at 2^CORE_SURFACE_EXPONENT. */
static uint32_t entry_of(const float *words, enum core_surface_axis axis, size_t i) {
  return integer_at(words, CORE_SURFACE_ENTRIES + CORE_SURFACE_AXIS * (size_t)axis + i);
}

static size_t cells_of(const float *words, enum core_surface_axis axis) {
  return integer_at(words, (size_t)CORE_SURFACE_CELLS + axis);
}

/* Writes the entries of an axis that covers [2^first, 2^end). Octave first + i has 2^cuts[i]
 * cells. */
static void lay_axis(float *words, enum core_surface_axis axis, int first, int end,
                     const uint8_t *cuts) {
  size_t cell = 0;
  for (int i = 0; i < CORE_SURFACE_AXIS; i++) {
    const int octave = CORE_SURFACE_EXPONENT + i - first;
    const bool inside = octave >= 0 && octave < end - first;
    const size_t entry = (size_t)CORE_SURFACE_ENTRIES + CORE_SURFACE_AXIS * axis + (size_t)i;
    put_integer(words, entry, inside ? cell << CORE_CELLS_ENTRY_BITS | cuts[octave] : 0);
    cell += inside ? (size_t)1 << cuts[octave] : 0;
  }
  words[CORE_SURFACE_LEAST + axis] = (float)ldexp(1, first);
  words[CORE_SURFACE_MOST + axis] = (float)(ldexp(1, end) * (1 - 0x1p-24));
  put_integer(words, (size_t)CORE_SURFACE_CELLS + axis, cell);
}

/* Sets nodes[] to coordinates in ascending order: `count` in each cell, at these shares of its
 * length, and the end of the axis. Returns their number without the last one. */
static size_t axis_nodes(const float *words, enum core_surface_axis axis, size_t count,
                         const double *shares, double *nodes) {
  const double least = (double)words[CORE_SURFACE_LEAST + axis];
  const size_t all = cells_of(words, axis);
  size_t node = 0;
  for (int i = ilogb(least) - CORE_SURFACE_EXPONENT; node < count * all; i++) {
    const double begin = ldexp(1, CORE_SURFACE_EXPONENT + i);
    const size_t cells = (size_t)1 << (entry_of(words, axis, (size_t)i) & 31);
    for (size_t k = 0; k < count * cells; k++) {
      const double place = (double)(k / count) + shares[k % count];
      nodes[node++] = begin * (1 + place / (double)cells);
    }
    nodes[node] = 2 * begin;
  }
  return node;
}

/* Returns the index of the cell that contains the coordinate x on an axis. *t is set to the place
 * in that cell. */
static size_t cell_at(const float *words, enum core_surface_axis axis, double x, double *t) {
  const int octave = ilogb(x);
  const uint32_t entry = entry_of(words, axis, (size_t)(octave - CORE_SURFACE_EXPONENT));
  const double place = (ldexp(x, -octave) - 1) * (double)(UINT32_C(1) << (entry & 31));
  const size_t index = (size_t)place;
  *t = place - (double)index;
  return (entry >> CORE_CELLS_ENTRY_BITS) + index;
}

/* The axes of each function; the first two functions have the same rows. */
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

/* Returns the number of words that a function takes. */
static size_t words_of(const float *words, enum core_surface_function function) {
  const size_t lines = shapes[function].has_rows
                           ? cells_of(words, CORE_SURFACE_S) + cells_of(words, CORE_SURFACE_W)
                           : 1;
  const bool line = !shapes[function].has_rows || shapes[function].columns == CORE_SURFACE_AXES;
  const size_t columns =
      shapes[function].columns == CORE_SURFACE_AXES ? 1 : cells_of(words, shapes[function].columns);
  return lines * columns * (line ? TERMS : PATCH);
}

/* ---- colours --------------------------------------------------------------------------------- */

enum {
  COLOUR_FIRST = -20, /* first octave of the colour, and of the largest colour minus the colour */
  COLOUR_REST_FIRST = -24,
  COLOUR_END = -1,
  COLOUR_CUTS = 2,
  /* the last octaves have more cuts, because the function bends there for dark media of a large
   * eta */
  COLOUR_FINE = 2,
  COLOUR_FINE_CUTS = 4,
  COLOUR_FINE_MORE = (COLOUR_FINE << COLOUR_FINE_CUTS) - (COLOUR_FINE << COLOUR_CUTS),
  COLOUR_CELLS = ((COLOUR_END - COLOUR_FIRST) << COLOUR_CUTS) + COLOUR_FINE_MORE,
  COLOUR_REST_CELLS = ((COLOUR_END - COLOUR_REST_FIRST) << COLOUR_CUTS) + COLOUR_FINE_MORE,
  COLOUR_WORDS = CORE_LIGHTS * TERMS * (COLOUR_CELLS + COLOUR_REST_CELLS),
  SECANTS = 40
};

/* Albedos of one light as a function of s = sqrt(sigma_a / sigma_t'). */
struct albedos {
  /* returns the albedo; w = 1 - s; it falls as s grows */
  double (*at)(const struct albedos *albedos, double s, double w);
  const double *shared; /* constants of a dipole (core/models/lanes.h) */
  const rows *rows;     /* rows of `transport` */
  enum core_light light;
};

static double transport_albedo(const struct albedos *albedos, double s, double w) {
  return rows_total(albedos->rows, albedos->light == CORE_LIGHT_DIFFUSE, s,
                    fmax(w, rows_w_least(albedos->rows)));
}

static double dipole_albedo(const struct albedos *albedos, double s, double w) {
  const struct lane lane = {s * s, 1, 1, s * s, w * (1 + s)};
  const struct lane_dipole dipole = lane_dipole_of(albedos->shared, lane);
  return 0.5 * dipole.power * dipole.sum;
}

/* Returns ln of the albedo of the medium with w = e^y. If `rest`: ln of (most - albedo) of the
 * medium with s = e^y. */
static double ln_albedo(const struct albedos *albedos, double most, bool rest, double y) {
  const double x = fn_exp(y);
  const double albedo = rest ? albedos->at(albedos, x, 1 - x) : albedos->at(albedos, 1 - x, x);
  return fn_log(fmax(rest ? most - albedo : albedo, 1e-300));
}

/* Solves ln_albedo(y) = wanted for y by the secant method, starting at y. The function rises and is
 * nearly a straight line of slope 1 or 2. A step that leaves the bracket is replaced by halving the
 * bracket: where the albedo is small, as in dark media with a large eta, most - albedo hardly
 * changes with y. */
static double find_medium(const struct albedos *albedos, double most, bool rest, double wanted,
                          double y) {
  double before = y - 0.01, off_before = ln_albedo(albedos, most, rest, before) - wanted;
  double low = -40, high = 0;
  for (int i = 0; i < SECANTS; i++) {
    const double off = ln_albedo(albedos, most, rest, y) - wanted;
    const double slope = (off - off_before) / (y - before);
    /* stops also below the least albedo, where the function is flat */
    if (fabs(off) < 1e-13 || (!rest && !(slope > 0.1))) {
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
    axis_nodes(words, rest ? CORE_SURFACE_COLOUR_REST : CORE_SURFACE_COLOUR, STEPS,
               core_cells_points, nodes);
    double y = fn_log(0.7); /* starts near the medium with half of the largest albedo */
    for (size_t i = STEPS * cells + 1; i-- > 0;) {
      y = find_medium(albedos, most, rest, fn_log(most * nodes[i]), y);
      values[i] = fn_exp(y);
    }
    core_cells_fit_lines(values, cells, &words[*at]);
    const enum core_surface_function function =
        rest ? CORE_SURFACE_S_OF_REST : CORE_SURFACE_W_OF_COLOUR;
    put_integer(words, (size_t)CORE_SURFACE_AT + function + albedos->light, *at);
    *at += TERMS * cells;
  }
}

/* Writes the functions from colours to media for the light of `albedos`. *at: position of the next
 * word. */
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
  S_FIRST = -17, /* first octave of each axis; the axis of s may begin lower: see first_of_s() */
  W_FIRST = -8,
  ALBEDO_END = -1,
  U_FIRST = -20,
  REST_FIRST = -24,
  U_END = -1,
  FINE_LEVEL = 2, /* the first level for tolerances below 2e-5 */
  LEVELS = 4
};

/* Returns the cuts of an octave of radii: log2 of its number of cells. Q has a kink at each fixed
 * edge of the table's series. If no boundary of cells falls on it, the octave gets more cells. */
static int cuts_of_radius(const transport_table *table, int octave, int level) {
  /* Multiple scattering overtakes single scattering near x = 8. The series for g end near x =
   * 100. */
  const int base = octave < -1 ? 0 : octave == 0 ? 3 : octave > 0 && octave < 8 ? 2 : 1;
  const bool bends = octave == 3 || (octave > 4 && octave < 8 && level > 0);
  int cuts = base + (octave < -11 ? 0 : level) + bends;
  for (int i = 0; i <= TRANSPORT_TABLE_NEAR + 1 + TRANSPORT_TABLE_D_NEAR; i++) {
    const double edge = table->field[i <= TRANSPORT_TABLE_NEAR
                                         ? TRANSPORT_TABLE_EDGES + i
                                         : TRANSPORT_TABLE_D_EDGES + i - TRANSPORT_TABLE_NEAR - 1];
    const double place = ldexp(edge, -octave); /* the edge relative to the octave's beginning */
    const double cell = ldexp(place - 1, cuts);
    if (place > 1 && place < 2 && fabs(cell - floor(cell + 0.5)) > 1e-6) {
      cuts = cuts > 1 + 3 * level ? cuts : 1 + 3 * level;
    }
  }
  /* The reach of the difference D moves with the albedo, up to this radius. It is a kink too. */
  const double reach = table->field[TRANSPORT_TABLE_D_REACH_MOST];
  if (level >= FINE_LEVEL && ldexp(1, octave) < reach && reach <= ldexp(1, octave + 1)) {
    cuts = CORE_SURFACE_CUTS_MAX;
  }
  return cuts < CORE_SURFACE_CUTS_MAX ? cuts : CORE_SURFACE_CUTS_MAX;
}

/* Returns the cuts of an octave of another axis. Each level adds one cut, which divides errors by
 * 16. Below s = 2^-reach every function is nearly a straight line in s. */
static int cuts_of(enum core_surface_axis axis, int octave, int reach, int level) {
  int base;
  if (axis == CORE_SURFACE_W) { /* fill_rows() begins the first octave late */
    base = octave == W_FIRST || octave == ALBEDO_END - 1 ? 2 : 1;
  } else if (axis == CORE_SURFACE_S) {
    base = octave + reach < -2 ? 0 : octave < -4 ? 1 : 2;
    level = octave + reach < -4 ? 0 : level;
  } else {
    base = octave >= -4 ? 2 : octave == -5 || axis == CORE_SURFACE_REST;
  }
  return base + level;
}

/* Returns the first octave of s. Media that absorb less, down to none, get the functions of the
 * least s. Their error is about 2 s x, which at the reach x is a small share of the tolerance. */
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

/* Writes the words of kappa: the polynomial in s that interpolates kappa / s at Chebyshev points,
 * by divided differences. */
static void put_kappa(const rows *all, float *words) {
  enum { COUNT = CORE_SURFACE_KAPPA_TERMS };
  double at[COUNT], d[COUNT], c[COUNT] = {0};
  for (int i = 0; i < COUNT; i++) {
    double sine, cosine;
    fn_sincos(FN_PI * (i + 0.5) / COUNT, &sine, &cosine);
    at[i] = 0.5 * (1 + cosine);
    d[i] = rows_kappa_per_s(all, at[i], 1 - at[i]);
  }
  for (int level = 1; level < COUNT; level++) {
    for (int i = COUNT - 1; i >= level; i--) {
      d[i] = (d[i] - d[i - 1]) / (at[i] - at[i - level]);
    }
  }
  /* Horner's scheme from Newton's form to powers: c = d[i] + (s - at[i]) c */
  for (int i = COUNT - 1; i >= 0; i--) {
    for (int k = COUNT - 1; k > 0; k--) {
      c[k] = c[k - 1] - at[i] * c[k];
    }
    c[0] = d[i] - at[i] * c[0];
  }
  for (int k = 0; k < COUNT; k++) {
    words[CORE_SURFACE_KAPPA + k] = (float)c[k];
  }
}

/* Sets Q[i] to Q for the rounded kappa that the words hold, in place of the exact one. */
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

/* Points on the axes, and the functions' values there, row by row. */
struct grid {
  size_t count[CORE_SURFACE_AXES];
  double *nodes[CORE_SURFACE_AXES];
  double *ln_x; /* ln of nodes[CORE_SURFACE_RADIUS] */
  double *values[CORE_SURFACE_TOTAL + 1];
  double *owned;
};

/* Returns how many points a function has in each row. */
static size_t columns_of(const struct grid *grid, int function) {
  return shapes[function].columns == CORE_SURFACE_AXES ? 1 : grid->count[shapes[function].columns];
}

/* Makes a grid of `lines` rows; 0: one row for each node of the albedos' axes. Each cell has points
 * at `count` shares of its length, and if `ends`, axes have points at their ends. Returns false if
 * memory runs out; otherwise the caller frees grid->owned. */
static bool make_grid(const float *words, size_t lines, size_t count, const double *shares,
                      bool ends, struct grid *grid) {
  size_t all = 0, places[CORE_SURFACE_AXES];
  for (int i = 0; i < CORE_SURFACE_COLOUR; i++) {
    grid->count[i] = count * cells_of(words, i) + ends;
    places[i] = count * cells_of(words, i) + 1;
    all += places[i];
  }
  lines = lines > 0 ? lines : grid->count[CORE_SURFACE_S] + grid->count[CORE_SURFACE_W];
  all += places[CORE_SURFACE_RADIUS];
  for (int i = 0; i <= CORE_SURFACE_TOTAL; i++) {
    all += lines * columns_of(grid, i);
  }
  double *free_from = grid->owned = malloc(all * sizeof *free_from);
  if (grid->owned == NULL) {
    return false;
  }
  for (int i = 0; i < CORE_SURFACE_COLOUR; i++) {
    grid->nodes[i] = free_from;
    free_from += places[i];
    axis_nodes(words, i, count, shares, grid->nodes[i]);
  }
  grid->ln_x = free_from;
  free_from += places[CORE_SURFACE_RADIUS];
  for (size_t i = 0; i < grid->count[CORE_SURFACE_RADIUS]; i++) {
    grid->ln_x[i] = fn_log(grid->nodes[CORE_SURFACE_RADIUS][i]);
  }
  for (int i = 0; i <= CORE_SURFACE_TOTAL; i++) {
    grid->values[i] = free_from;
    free_from += lines * columns_of(grid, i);
  }
  return true;
}

/* Copies the values of one row of the table, the solutions of one albedo, into the grid, where it is
 * the row `index`. */
static void set_values(const float *words, const struct grid *grid, const rows_row *row,
                       size_t index) {
  const double *x = grid->nodes[CORE_SURFACE_RADIUS];
  double *out[CORE_SURFACE_TOTAL + 1];
  for (int i = 0; i <= CORE_SURFACE_TOTAL; i++) {
    out[i] = &grid->values[i][index * columns_of(grid, i)];
  }
  Q_of_words(words, row, grid->count[CORE_SURFACE_RADIUS], x, grid->ln_x, out[CORE_SURFACE_Q]);
  for (size_t i = 0; i < grid->count[CORE_SURFACE_RADIUS]; i++) {
    out[CORE_SURFACE_CDF][i] = rows_cdf(row, x[i]);
  }
  rows_found found = {0};
  for (size_t i = 0; i < grid->count[CORE_SURFACE_U]; i++) {
    out[CORE_SURFACE_X_OF_U][i] = rows_radius(row, grid->nodes[CORE_SURFACE_U][i], &found);
  }
  found = (rows_found){0};
  for (size_t i = 0; i < grid->count[CORE_SURFACE_REST]; i++) {
    out[CORE_SURFACE_X_OF_REST][i] =
        rows_radius_of_rest(row, grid->nodes[CORE_SURFACE_REST][i], &found);
  }
  *out[CORE_SURFACE_TOTAL] = row->total;
}

/* Sets the words of all functions of a surface from the values. */
static void put_functions(const struct grid *grid, float *words, size_t *at) {
  for (int i = 0; i <= CORE_SURFACE_TOTAL; i++) {
    const double *values = grid->values[i];
    put_integer(words, (size_t)CORE_SURFACE_AT + (size_t)i, *at);
    for (int axis = CORE_SURFACE_S; axis <= CORE_SURFACE_W; axis++) {
      const size_t cells = cells_of(words, axis);
      if (i == CORE_SURFACE_TOTAL) {
        core_cells_fit_lines(values, cells, &words[*at]);
        *at += TERMS * cells;
      } else {
        const size_t columns = cells_of(words, shapes[i].columns);
        core_cells_fit_patches(values, cells, columns, &words[*at]);
        *at += PATCH * cells * columns;
      }
      values += grid->count[axis] * columns_of(grid, i);
    }
  }
}

/* ---- measuring ------------------------------------------------------------------------------- */

/* The stated error is the one found in the middle of cells, and of R at kinks, times this. */
#define FOUND_MARGIN 1.2

/* A place among the rows. */
struct among {
  size_t cell; /* of both axes of albedos */
  double p;
};

/* Returns the relative error of a function where a row and a coordinate meet, and for Q that of R; 0
 * beyond the reach. */
static double error_at(const float *words, int function, struct among row, double reach, double x,
                       double exact) {
  const enum core_surface_axis axis = shapes[function].columns;
  if (!((axis == CORE_SURFACE_RADIUS ? x : exact) <= reach)) {
    return 0;
  }
  double t;
  const size_t cell = cell_at(words, axis, x, &t);
  const size_t at = integer_at(words, (size_t)CORE_SURFACE_AT + (size_t)function) +
                    PATCH * (row.cell * cells_of(words, axis) + cell);
  const double found = core_cells_patch(&words[at], row.p, t);
  return function == CORE_SURFACE_Q ? fabs(found - exact) : fabs(found / exact - 1);
}

/* Returns the largest error of all functions for one row: at the points of a grid, and at kinks of
 * Q. The pdf has that of R and of the total. */
static double measure_row(const float *words, const struct grid *grid, const rows_row *row,
                          struct among place) {
  const float *far = &words[CORE_SURFACE_FAR];
  const double reach = 1 / ((double)far[0] + row->s * ((double)far[1] + row->s * (double)far[2]));
  double x[ROWS_EDGES_MAX], ln_x[ROWS_EDGES_MAX], Q[ROWS_EDGES_MAX], worst = 0;
  set_values(words, grid, row, 0);
  for (int i = 0; i < CORE_SURFACE_TOTAL; i++) {
    const double *nodes = grid->nodes[shapes[i].columns];
    for (size_t k = 0; k < columns_of(grid, i); k++) {
      worst = fmax(worst, error_at(words, i, place, reach, nodes[k], grid->values[i][k]));
    }
  }
  const size_t kinks = rows_edges(row, x);
  for (size_t i = 0; i < kinks; i++) {
    ln_x[i] = fn_log(x[i]);
  }
  Q_of_words(words, row, kinks, x, ln_x, Q);
  for (size_t i = 0; i < kinks; i++) {
    worst = fmax(worst, error_at(words, CORE_SURFACE_Q, place, reach, x[i], Q[i]));
  }
  const size_t total = integer_at(words, (size_t)CORE_SURFACE_AT + CORE_SURFACE_TOTAL);
  return worst +
         fabs(core_cells_line(&words[total + TERMS * place.cell], place.p) / row->total - 1);
}

/* Returns the largest error in the middle of cells of both axes of albedos, and without absorption;
 * -1 if memory runs out. */
static double measure(const rows *all, const float *words, rows_row *row) {
  static const double middle[1] = {0.5};
  struct grid grid;
  if (!make_grid(words, 1, 1, middle, false, &grid)) {
    return -1;
  }
  rows_fill(all, 0, 1, row);
  double worst = measure_row(words, &grid, row, (struct among){0, 0});
  size_t cell = 0;
  for (int axis = CORE_SURFACE_S; axis <= CORE_SURFACE_W; axis++) {
    for (size_t i = 0; i < grid.count[axis]; i++, cell++) {
      const double node = grid.nodes[axis][i], w = axis == CORE_SURFACE_S ? 1 - node : node;
      if (w >= rows_w_least(all)) {
        rows_fill(all, axis == CORE_SURFACE_S ? node : 1 - node, w, row);
        worst = fmax(worst, measure_row(words, &grid, row, (struct among){cell, 0.5}));
      }
    }
  }
  free(grid.owned);
  return worst;
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

/* Fills the rows of an axis of albedos; `first` is the number of the first one. */
static void fill_rows(const rows *all, const float *words, const struct grid *grid,
                      enum core_surface_axis axis, size_t first, rows_row *row) {
  for (size_t i = 0; i < grid->count[axis]; i++) {
    const double node = grid->nodes[axis][i];
    const bool by_s = axis == CORE_SURFACE_S;
    /* Rows far below the least albedo only fill up the first octave. */
    const double w = fmax(by_s ? 1 - node : node, 0.95 * rows_w_least(all));
    rows_fill(all, by_s ? node : 1 - w, w, row);
    set_values(words, grid, row, first + i);
  }
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
  if (*words == NULL || !make_grid(header, 0, STEPS, core_cells_points, true, &grid)) {
    free(*words);
    return CORE_OUT_OF_MEMORY;
  }
  memcpy(*words, header, CORE_SURFACE_PATCHES * sizeof *header);
  put_kappa(all, *words);
  put_far(inputs, *words);
  fill_rows(all, *words, &grid, CORE_SURFACE_S, 0, row);
  fill_rows(all, *words, &grid, CORE_SURFACE_W, grid.count[CORE_SURFACE_S], row);
  size_t at = CORE_SURFACE_PATCHES;
  put_functions(&grid, *words, &at);
  free(grid.owned);
  put_all_colours(all, NULL, *words, &at);
  (*words)[CORE_SURFACE_SCATTERED_LEAST] =
      (float)(rows_w_least(all) * (2 - rows_w_least(all)) * (1 + 0x1p-20));
  const double worst = measure(all, *words, row);
  if (worst < 0) {
    free(*words); /* words of another level would have other digits */
    return CORE_OUT_OF_MEMORY;
  }
  (*words)[CORE_SURFACE_ERROR] = (float)(FOUND_MARGIN * worst + rows_error(all));
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

/* Whether coordinates between the ends of an axis have an entry, and every entry has cells. */
static bool axis_good(const float *words, enum core_surface_axis axis, size_t most_cells) {
  const double least = (double)words[CORE_SURFACE_LEAST + axis];
  const double most = (double)words[CORE_SURFACE_MOST + axis];
  const size_t cells = cells_of(words, axis);
  bool good = least >= ldexp(1, CORE_SURFACE_EXPONENT) && least < most &&
              most < ldexp(1, CORE_SURFACE_EXPONENT + CORE_SURFACE_AXIS) && cells <= most_cells;
  for (size_t i = 0; good && i < CORE_SURFACE_AXIS; i++) {
    const uint32_t entry = entry_of(words, axis, i);
    good =
        core_cells_hold(entry >> CORE_CELLS_ENTRY_BITS, entry & 31, CORE_SURFACE_CUTS_MAX, cells);
  }
  return good;
}

core_fault core_surface_check(const float *words, size_t count, bool is_transport) {
  bool good = count >= CORE_SURFACE_PATCHES && count <= INT32_MAX &&
              integer_at(words, CORE_SURFACE_VERSION_WORD) == CORE_SURFACE_VERSION;
  for (int axis = is_transport ? 0 : CORE_SURFACE_COLOUR; good && axis < CORE_SURFACE_AXES;
       axis++) {
    good = axis_good(words, axis, count / TERMS);
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
