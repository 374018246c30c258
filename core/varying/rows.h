/* rows: the rows of a surface. Each row is one medium of `transport`, evaluated from the table of
 * solutions: Q, the cdf and its inverse (core/varying/surface.h). Lengths are in mean free
 * paths. */
#ifndef DIPOLED_CORE_VARYING_ROWS_H
#define DIPOLED_CORE_VARYING_ROWS_H

#include "core/transport/table.h"

enum {
  ROWS_FIRST = -20, /* first octave of x with rows; at smaller x, x R is constant */
  ROWS_END = 14,
  ROWS_FAR_END = 40, /* the energy is integrated up to 2^ROWS_FAR_END */
  ROWS_OCTAVES = ROWS_FAR_END - ROWS_FIRST,
  /* A panel is an octave, or a part of one: fixed edges of the table, where Q has kinks, divide
   * octaves. */
  ROWS_CUTS_MAX = TRANSPORT_TABLE_NEAR + 1 + TRANSPORT_TABLE_D_NEAR + 1,
  ROWS_PANELS_MAX = ROWS_OCTAVES + ROWS_CUTS_MAX,
  ROWS_TERMS = 16 /* coefficients of a series in a panel */
};

/* Q of one medium of the table. Beyond its reach R continues as in core/models/transport.c. */
typedef struct rows_source {
  transport_series series;
  double last_Q; /* Q at the reach */
  double steeper, fading;
} rows_source;

enum { ROWS_BASES = 3 };

/* What all rows of one g and eta have in common. */
typedef struct rows rows;

typedef struct rows_row {
  const rows *all;
  double s, w; /* w = 1 - s */
  double albedo;
  double kappa;
  double total;
  rows_source source;
  /* The row's Q is the sum over i of weight[i] times Q of base[i]: of the row's own medium alone,
   * or of those that it is extrapolated from. */
  const rows_source *base[ROWS_BASES];
  double weight[ROWS_BASES]; /* source, or those that it is extrapolated from */
  double lift;               /* added to Q, so that the integral of R equals the total */
  /* For each panel, as shares of the total: the energy from its start to x, as a Chebyshev series;
   * the energy below its start; and the energy above its start. */
  double within[ROWS_PANELS_MAX][ROWS_TERMS];
  double before[ROWS_PANELS_MAX + 1];
  double beyond[ROWS_PANELS_MAX + 1];
} rows_row;

/* Creates rows whose R has a relative error against the table that is far below the tolerance.
 * Returns NULL if memory runs out. The table has to cover g and eta (asserted). The caller frees
 * the rows with rows_free(), which accepts NULL. */
rows *rows_create(const transport_table *table, double g, double eta, double tolerance);
void rows_free(rows *all);

/* Returns the relative error of R of the rows against the table. */
double rows_error(const rows *all);

/* Returns the least w = 1 - sqrt(1 - albedo) of an albedo that the table covers. Rows with a w
 * slightly below it are extrapolated. So are rows with an s slightly below that of the largest
 * albedo of the table. */
double rows_w_least(const rows *all);

/* Sets *row, which `all` has to outlive, to that of s = sqrt(sigma_a / sigma_t') and w = 1 - s, which both are given since one
 * of them may be small. s: 0 to 1. */
void rows_fill(const rows *all, double s, double w, rows_row *row);

/* Returns the energy that leaves per power that has entered, of diffuse light or of a beam. */
double rows_total(const rows *all, bool diffuse, double s, double w);

/* Returns kappa / s. */
double rows_kappa_per_s(const rows *all, double s, double w);

/* Sets Q[i] to Q with the exact kappa at y[i] = ln x, in ascending order. */
void rows_Q(const rows_row *row, size_t n, const double *y, double *Q);

/* Sets x[] to the radii, in ascending order, at which Q of a row may have a kink: the edges of its
 * series within the octaves that have rows. Returns their number. */
enum { ROWS_EDGES_MAX = 2 * (TRANSPORT_TABLE_PANELS + 1) };
size_t rows_edges(const rows_row *row, double x[ROWS_EDGES_MAX]);

/* The result of a search for a radius, where the next search of the row starts. All zero before the
 * first. */
typedef struct rows_found {
  double energy; /* u, or -rest */
  double x;
  double per_energy; /* d x / d energy; 0 before the first search */
} rows_found;

/* Return the cdf at x, and the radius whose cdf is u, or 1 - rest. `last` is where the radius of the
 * number before was found, in the same row; it is set anew. */
double rows_cdf(const rows_row *row, double x);
double rows_radius(const rows_row *row, double u, rows_found *last);
double rows_radius_of_rest(const rows_row *row, double rest, rows_found *last);

#endif
