/* table: a table of solutions of radiative transport (see transport.h), as a series over albedo,
 * eta and radius. The table is part of the program (transport.table, made by `make tables`).
 *
 * The table holds what is left of R (per squared mean free path, x in mean free paths) after its
 * source and its decay have been divided out:
 *
 *   Q = ln(x R / a) + kappa x - ln(1 + kappa x).
 *
 * Near the source R is in proportion to a / x, up to terms of relative size x ln x. Far away, where
 * R is diffusion, R is in proportion to (1 + kappa x) e^(-kappa x) / x^3. Q is smooth at both ends
 * in ln x, and smooth in the coordinates
 *
 *   t = ln(s / (1 - s)), s = sqrt(1 - a):   kappa and all that diffuses is smooth in s near a = 1;
 *   v = sqrt(1 - 1 / eta^2) for eta >= 1,   Fresnel's reflectance is not smooth at eta = 1, so each
 *       sqrt(1 - eta^2)     for eta < 1:    side has a table of its own;
 *   y = ln x, in panels: each panel reaches from one edge to the next. The last edge, the reach, is
 *       x = 1 / (kappa / decays + 1 / most), so that panels end where R does, and Q with them is a
 *       smooth function of kappa. The panels between the last fixed edge and the reach have the
 *       same width in y.
 *
 * The table holds the total (the energy that leaves per power that has entered) as ln(total / a).
 *
 * FORMAT, version 1. Numbers are little-endian.
 *
 *   bytes    what
 *   0-7      "dipoletr"
 *   8-11     version, u32
 *   12-15    length of the whole table in bytes, u32
 *   16-23    checksum of all bytes from 24 on, u64: FNV-1a (Fowler, Noll, Vo)
 *   24-...   TRANSPORT_TABLE_FIELDS numbers, f64, see transport_table_field
 *   ...      eta < 1, then eta >= 1: the total, then each panel from the source outwards, as series
 *
 * A series is a sum of c_kij T_k T_i T_j: Chebyshev polynomials of y (in the panel), t and v (in
 * the table's range), each mapped to -1 to 1. The bytes of a series are the number of k (one byte;
 * 1 for the total), for each k the number of i (one byte), for each i the number of j (one byte),
 * and for each j the integer c / quantum. An integer is written in zigzag order (0, -1, 1, -2, ...
 * become 0, 1, 2, 3, ...), seven bits to a byte, the lowest first; the eighth bit of a byte is set
 * if another byte follows.
 *
 * ERROR: the table was compared with the solver at media and radii that were not used to make it.
 * The field ERROR is TRANSPORT_TABLE_MARGIN times the largest relative error that was found, of R
 * where R is above TRANSPORT_TABLE_R_LEAST and of the total.
 */
#ifndef DIPOLED_CORE_TRANSPORT_TABLE_H
#define DIPOLED_CORE_TRANSPORT_TABLE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define TRANSPORT_TABLE_MAGIC "dipoletr"
/* smallest R that the field ERROR holds for, per squared mean free path */
#define TRANSPORT_TABLE_R_LEAST 1e-12
#define TRANSPORT_TABLE_MARGIN 1.5

enum {
  TRANSPORT_TABLE_VERSION = 1,
  TRANSPORT_TABLE_NEAR = 2, /* number of panels between the fixed edges */
  TRANSPORT_TABLE_FAR = 2,  /* number of panels from the last fixed edge to the reach */
  TRANSPORT_TABLE_PANELS = TRANSPORT_TABLE_NEAR + TRANSPORT_TABLE_FAR,
  TRANSPORT_TABLE_TERMS_MAX = 96, /* largest number of terms in each direction */
};

enum transport_table_field {
  TRANSPORT_TABLE_ERROR,        /* largest relative error, see ERROR above */
  TRANSPORT_TABLE_QUANTUM,      /* unit of the coefficients */
  TRANSPORT_TABLE_ALBEDO_LEAST, /* smallest albedo that the table covers */
  TRANSPORT_TABLE_ALBEDO_MOST,
  TRANSPORT_TABLE_ETA_LEAST,
  TRANSPORT_TABLE_ETA_MOST,
  TRANSPORT_TABLE_REACH_DECAYS, /* `decays` in the formula of the reach above */
  TRANSPORT_TABLE_REACH_MOST,   /* `most` in the formula of the reach above, in mean free paths */
  /* first of TRANSPORT_TABLE_NEAR + 1 fixed edges, in mean free paths */
  TRANSPORT_TABLE_EDGES,
  TRANSPORT_TABLE_FIELDS = TRANSPORT_TABLE_EDGES + TRANSPORT_TABLE_NEAR + 1
};

enum { TRANSPORT_TABLE_HEADER_BYTES = 24 + 8 * TRANSPORT_TABLE_FIELDS };

enum transport_table_side {
  TRANSPORT_TABLE_BELOW_1,
  TRANSPORT_TABLE_FROM_1,
  TRANSPORT_TABLE_SIDES
};

/* An opened table. It points into the bytes that it was opened from. */
typedef struct transport_table {
  double field[TRANSPORT_TABLE_FIELDS];
  /* position where each side begins, and the end of the last */
  const uint8_t *side[TRANSPORT_TABLE_SIDES + 1];
} transport_table;

/* Opens a table after checking all of its bytes. Returns false if the bytes are damaged or of
 * another version; then *table must not be used. The bytes may have any values and any alignment.
 * They must outlive the table. */
bool transport_table_open(transport_table *table, const uint8_t *bytes, size_t length);

/* Returns the table that is part of the program, or NULL if it is damaged. It is mapped read-only
 * with the program, and all processes share it. Any thread may call this at any time. */
const transport_table *transport_table_shipped(void);

/* Returns whether the table covers a medium with this single-scattering albedo and eta. Any numbers
 * may be passed. */
bool transport_table_covers(const transport_table *table, double albedo, double eta);

/* Returns the largest relative error of R, where R is above TRANSPORT_TABLE_R_LEAST, and of the
 * total. */
double transport_table_error(const transport_table *table);

/* One medium of the table: Chebyshev series in ln x. */
typedef struct transport_series {
  double kappa; /* transport_kappa() of the albedo */
  double total; /* the energy that leaves, per power that has entered */
  double ln_albedo;
  double edge[TRANSPORT_TABLE_PANELS + 1]; /* edges in ln x; the last one is the reach */
  size_t terms[TRANSPORT_TABLE_PANELS];
  double term[TRANSPORT_TABLE_PANELS][TRANSPORT_TABLE_TERMS_MAX];
} transport_series;

/* Sets *series to the series of a medium, which the table has to cover (asserted). The result has
 * the same bits on every machine. */
void transport_table_look_up(const transport_table *table, double albedo, double eta,
                             transport_series *series);

/* Returns ln(x R) + kappa x at y = ln x, for y from the first edge to the last (asserted, up to
 * rounding). */
double transport_series_at(const transport_series *series, double y);

/* ---- for making tables --------------------------------------------------------------------- */

/* These convert between albedo and t and between eta and its side and v, as the table's first
 * comment defines them. */
double transport_table_t(double albedo);
double transport_table_albedo(double t);
enum transport_table_side transport_table_side(double eta);
double transport_table_v(double eta);
double transport_table_eta(enum transport_table_side side, double v);

/* Sets range[0] to the v of eta = 1, which is 0, and range[1] to the other end of v on this side.
 */
void transport_table_v_range(const double *field, enum transport_table_side side, double range[2]);

/* Sets edge to the edges in ln x for a medium with this kappa. */
void transport_table_edges(const double *field, double kappa,
                           double edge[TRANSPORT_TABLE_PANELS + 1]);

/* Returns the checksum of `length` bytes, which in a table are those from byte 24 to the end. */
uint64_t transport_table_checksum(const uint8_t *bytes, size_t length);

#endif
