/* table: radiative transport looked up. What transport.h solves, as a series over albedo, eta and
 * radius, which is part of the program (transport.table, made by `make tables`).
 *
 * What is tabulated is what is left of R (per squared mean free path, x in mean free paths) after
 * its source and its decay have been divided out:
 *
 *   Q = ln(x R / a) + kappa x - ln(1 + kappa x).
 *
 * Near the source R = const a / x, up to x ln x; far away, where it is diffusion that is left of
 * it, R is proportional to (1 + kappa x) e^(-kappa x) / x^3. Both ends are smooth in ln x, and so
 * is Q, in the coordinates
 *
 *   t = ln(s / (1 - s)), s = sqrt(1 - a):   kappa and all that diffuses is smooth in s near a = 1;
 *   v = sqrt(1 - 1 / eta^2) for eta >= 1,   Fresnel's reflectance is not smooth at eta = 1: two
 *       sqrt(1 - eta^2)     for eta < 1:    sides, each a table of its own;
 *   y = ln x, in panels: from each edge below to the next. The last edge, the reach, is
 *       x = 1 / (kappa / decays + 1 / most), so that panels end where R does, and Q with them is a
 *       smooth function of kappa. The panels between the last fixed edge and the reach have the
 *       same width in y.
 *
 * The total (the energy that leaves per power that has entered) is tabulated as ln(total / a).
 *
 * FORMAT, version 1. Numbers are little-endian.
 *
 *   bytes    what
 *   0-7      "dipoletr"
 *   8-11     version, u32
 *   12-15    length of the whole in bytes, u32
 *   16-23    checksum of all that follows, u64: FNV-1a (Fowler, Noll, Vo)
 *   24-...   TRANSPORT_TABLE_FIELDS numbers, f64, see transport_table_field
 *   ...      eta < 1, then eta >= 1: the total, then each panel from the source outwards, as series
 *
 * A series is a sum of c_kij T_k T_i T_j, Chebyshev polynomials of y (of the panel), t and v (of
 * the range of the table), each mapped to -1 to 1. It is written as the number of k (one byte; 1
 * for the total), for each k the number of i (one byte), for each i the number of j (one byte), for
 * each j the integer c / quantum: zigzag (0, -1, 1, -2, ... are 0, 1, 2, 3, ...), seven bits to a
 * byte, the lowest first; the eighth bit says that more follow.
 *
 * ERROR: the table was compared with the solver, at media and radii that were not used for making
 * it; the field ERROR is TRANSPORT_TABLE_MARGIN times the worst that was seen of R where R is above
 * TRANSPORT_TABLE_R_LEAST, and of the total.
 */
#ifndef DIPOLED_CORE_TRANSPORT_TABLE_H
#define DIPOLED_CORE_TRANSPORT_TABLE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define TRANSPORT_TABLE_MAGIC "dipoletr"
#define TRANSPORT_TABLE_R_LEAST 1e-12 /* per squared mean free path */
#define TRANSPORT_TABLE_MARGIN 1.5

enum {
  TRANSPORT_TABLE_VERSION = 1,
  TRANSPORT_TABLE_NEAR = 2, /* panels between fixed edges */
  TRANSPORT_TABLE_FAR = 2,  /* and from there to the reach */
  TRANSPORT_TABLE_PANELS = TRANSPORT_TABLE_NEAR + TRANSPORT_TABLE_FAR,
  TRANSPORT_TABLE_TERMS_MAX = 96, /* in each direction */
};

enum transport_table_field {
  TRANSPORT_TABLE_ERROR,        /* relative */
  TRANSPORT_TABLE_QUANTUM,      /* of the coefficients */
  TRANSPORT_TABLE_ALBEDO_LEAST, /* covered */
  TRANSPORT_TABLE_ALBEDO_MOST,
  TRANSPORT_TABLE_ETA_LEAST,
  TRANSPORT_TABLE_ETA_MOST,
  TRANSPORT_TABLE_REACH_DECAYS, /* times 1 / kappa */
  TRANSPORT_TABLE_REACH_MOST,   /* mean free paths */
  TRANSPORT_TABLE_EDGES,        /* TRANSPORT_TABLE_NEAR + 1 of them, mean free paths */
  TRANSPORT_TABLE_FIELDS = TRANSPORT_TABLE_EDGES + TRANSPORT_TABLE_NEAR + 1
};

enum { TRANSPORT_TABLE_HEADER_BYTES = 24 + 8 * TRANSPORT_TABLE_FIELDS };

enum transport_table_side {
  TRANSPORT_TABLE_BELOW_1,
  TRANSPORT_TABLE_FROM_1,
  TRANSPORT_TABLE_SIDES
};

/* An opened table; it points into the bytes that it was opened from. */
typedef struct transport_table {
  double field[TRANSPORT_TABLE_FIELDS];
  const uint8_t *side[TRANSPORT_TABLE_SIDES + 1]; /* where each begins, and the end */
} transport_table;

/* Checks a table's bytes, all of them, and opens it. False: damaged, or of another version; then
 * *table is not to be used. bytes: any, of any alignment; they must outlive the table. */
bool transport_table_open(transport_table *table, const uint8_t *bytes, size_t length);

/* The table that is part of the program; NULL when that is damaged. It is mapped with the program,
 * read-only, and shared by all processes. Any thread may ask at any time. */
const transport_table *transport_table_shipped(void);

/* albedo: of single scattering; any numbers. */
bool transport_table_covers(const transport_table *table, double albedo, double eta);

/* Relative, of R where it is above TRANSPORT_TABLE_R_LEAST, and of the total. */
double transport_table_error(const transport_table *table);

/* One medium of the table: Chebyshev series in ln x. */
typedef struct transport_series {
  double kappa; /* transport_kappa() */
  double total; /* the energy that leaves, per power that has entered */
  double ln_albedo;
  double edge[TRANSPORT_TABLE_PANELS + 1]; /* of ln x; the last is the reach */
  size_t terms[TRANSPORT_TABLE_PANELS];
  double term[TRANSPORT_TABLE_PANELS][TRANSPORT_TABLE_TERMS_MAX];
} transport_series;

/* Asserted: the table covers the medium. The same bits on every machine. */
void transport_table_look_up(const transport_table *table, double albedo, double eta,
                             transport_series *series);

/* ln(x R) + kappa x at y = ln x, from the first edge to the last (asserted, up to rounding). */
double transport_series_at(const transport_series *series, double y);

/* ---- for making tables --------------------------------------------------------------------- */

/* The coordinates t and v, and back. */
double transport_table_t(double albedo);
double transport_table_albedo(double t);
enum transport_table_side transport_table_side(double eta);
double transport_table_v(double eta);
double transport_table_eta(enum transport_table_side side, double v);

/* The ends of v on a side: that of eta = 1 first. */
void transport_table_v_range(const double *field, enum transport_table_side side, double range[2]);

/* The edges of ln x for a medium with this kappa. */
void transport_table_edges(const double *field, double kappa,
                           double edge[TRANSPORT_TABLE_PANELS + 1]);

/* Of bytes 24 to the end. */
uint64_t transport_table_checksum(const uint8_t *bytes, size_t length);

#endif
