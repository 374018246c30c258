/* table: a table of solutions of radiative transport (see core/solver/solver.h), as a series
 * over albedo, g, eta and radius. The table is part of the program (transport.table, made by `make
 * tables`). Scattering is that of Henyey and Greenstein (1941) with the mean cosine g.
 *
 * Lengths are in reduced mean free paths 1 / (sigma_a + sigma_s'), sigma_s' = sigma_s (1 - g), and R
 * is per squared reduced mean free path. The albedo is the reduced one, sigma_s' / (sigma_a +
 * sigma_s'). x is the radius.
 *
 * The table holds what is left of R after its source and its decay have been divided out:
 *
 *   Q = ln(x R / a) + kappa x - ln(1 + kappa x).
 *
 * Near the source R is in proportion to a / x, up to terms of relative size x ln x. Far away, where
 * R is diffusion, R is in proportion to (1 + kappa x) e^(-kappa x) / x^3. Q is smooth at both ends
 * in ln x. The table has two parts: Q for isotropic scattering, and the difference
 *
 *   D = Q(g) - Q(0),
 *
 * each with the medium's own kappa. The parts are smooth in the coordinates
 *
 *   t = ln(s / (1 - s)), s = sqrt(1 - a):   for isotropic scattering: kappa and all that diffuses is
 *                                           smooth in s near a = 1;
 *   u = ln((s + 0.6) / (1.03 - s))          for D: like s near a = 1, like ln(1 - s) near a = 0,
 *                                           where single scattering takes over;
 *   w = g + g^2 / 20                        for D;
 *   v = sqrt(1 - 1 / eta^2) for eta >= 1,   Fresnel's reflectance is not smooth at eta = 1, so each
 *       sqrt(1 - eta^2)     for eta < 1:    side has its own table;
 *   y = ln x, in panels: each panel reaches from one edge to the next. The last edge, the reach, is
 *       x = 1 / (kappa / decays + 1 / most) with the kappa of isotropic scattering, so that panels
 *       end where R does, and Q with them is a smooth function of kappa. The panels between the last
 *       fixed edge and the reach have the same width in y. Each part has its own edges. Beyond its
 *       reach D continues with its slope there, which fades within TRANSPORT_TABLE_D_FADES of y,
 * like       1 / x: R is diffusion there, or so small that the errors below do not hold for it.
 *
 * For isotropic scattering the table holds the total (the energy that leaves per power that has
 * entered) as ln(total / a). For other media it holds ln(total / a) for a beam at right angles and
 * for diffuse light, which strikes the surface with the same radiance from all directions.
 *
 * FORMAT, version 3. Numbers are little-endian.
 *
 *   bytes    what
 *   0-7      "dipoletr"
 *   8-11     version, u32
 *   12-15    length of the whole table in bytes, u32
 *   16-23    checksum of all bytes from 24 on, u64: FNV-1a (Fowler, Noll, Vo)
 *   24-...   TRANSPORT_TABLE_FIELDS numbers, f64, see transport_table_field
 *   ...      isotropic scattering, eta < 1, then eta >= 1: the total, then each panel from the source
 *            outwards, as series
 *   ...      D, eta < 1, then eta >= 1: the total for the beam, the total for diffuse light, then
 *            each panel, as series
 *
 * A series is a sum of c_kij T_k T_i T_j, Chebyshev polynomials of y (in the panel), t and v (in
 * the table's range), each mapped to -1 to 1. A series of D is a sum of c_klij T_k T_l T_i T_j over
 * y, w, u and v. The bytes of a series are the number of k (one byte; 1 for a total), for each k the
 * number of the next index (one byte), and so on, and for each j the integer c / quantum, of at most
 * 32 bits, packed as core/chebyshev.h says.
 *
 * ERROR: the table was compared with the solvers at media and radii that were not used to make it.
 * The stated errors are TRANSPORT_TABLE_MARGIN times the largest relative error that was found, of
 * R where R is above TRANSPORT_TABLE_R_LEAST and of the totals, plus the error of the solver itself.
 * For g other than 0 there is an error for each region: a band of g, of the albedo, of eta and of x.
 * Their margin is TRANSPORT_TABLE_MARGIN_D.
 * The largest error that was found is 5.1e-4 for x up to 100: for g below -0.25, with sigma_a above 10
 * sigma_s' from x = 1 to 10, and with less beyond 20. Elsewhere it is 2.9e-4. For x above 100, which
 * profiles leave to their reach, the largest difference from the solver is 1.7e-3. Totals for g other
 * than 0 are within 7.4e-7 for the beam and 2.1e-6 for diffuse light.
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
/* factor of safety of the stated errors of regions with g other than 0, which few media were tested
 * in */
#define TRANSPORT_TABLE_MARGIN_D 2.0

#define TRANSPORT_TABLE_D_FADES 1.0

enum {
  TRANSPORT_TABLE_VERSION = 3,
  TRANSPORT_TABLE_PANELS = 4,
  /* number of panels between fixed edges, for isotropic scattering and for D */
  TRANSPORT_TABLE_NEAR = 2,
  TRANSPORT_TABLE_D_NEAR = 3,
  TRANSPORT_TABLE_TERMS_MAX = 96, /* largest number of terms in each coordinate */
  /* numbers of bands whose errors are stated, for g other than 0: see transport_table_region() */
  TRANSPORT_TABLE_BANDS_G = 4,
  TRANSPORT_TABLE_BANDS_ALBEDO = 5,
  TRANSPORT_TABLE_BANDS_ETA = 2,
  TRANSPORT_TABLE_BANDS_X = 6,
  TRANSPORT_TABLE_REGIONS = TRANSPORT_TABLE_BANDS_G * TRANSPORT_TABLE_BANDS_ALBEDO *
                            TRANSPORT_TABLE_BANDS_ETA * TRANSPORT_TABLE_BANDS_X
};

enum transport_table_field {
  TRANSPORT_TABLE_ERROR,   /* isotropic scattering: largest relative error of R and of the total */
  TRANSPORT_TABLE_QUANTUM, /* isotropic scattering: unit of the integer coefficients */
  TRANSPORT_TABLE_ALBEDO_LEAST, /* smallest albedo that the table covers */
  TRANSPORT_TABLE_ALBEDO_MOST,
  TRANSPORT_TABLE_ETA_LEAST,
  TRANSPORT_TABLE_ETA_MOST,
  TRANSPORT_TABLE_REACH_DECAYS, /* `decays` in the formula of the reach above */
  TRANSPORT_TABLE_REACH_MOST,   /* `most` in the formula of the reach above, in mean free paths */
  /* first of TRANSPORT_TABLE_NEAR + 1 fixed edges, in mean free paths */
  TRANSPORT_TABLE_EDGES,
  /* of D */
  TRANSPORT_TABLE_D_QUANTUM = TRANSPORT_TABLE_EDGES + TRANSPORT_TABLE_NEAR + 1,
  TRANSPORT_TABLE_G_LEAST,
  TRANSPORT_TABLE_G_MOST,
  TRANSPORT_TABLE_D_REACH_DECAYS,
  TRANSPORT_TABLE_D_REACH_MOST,
  /* first of TRANSPORT_TABLE_D_NEAR + 1 fixed edges */
  TRANSPORT_TABLE_D_EDGES,
  /* unit of the coefficients of totals for g other than 0 */
  TRANSPORT_TABLE_TOTALS_QUANTUM = TRANSPORT_TABLE_D_EDGES + TRANSPORT_TABLE_D_NEAR + 1,
  /* largest relative error of the total for g other than 0 */
  TRANSPORT_TABLE_TOTALS_ERROR,
  /* largest relative error of the total of diffuse light, in each band of the albedo */
  TRANSPORT_TABLE_DIFFUSE_ERRORS,
  /* first of TRANSPORT_TABLE_REGIONS largest relative errors of R for g other than 0 */
  TRANSPORT_TABLE_D_ERRORS = TRANSPORT_TABLE_DIFFUSE_ERRORS + TRANSPORT_TABLE_BANDS_ALBEDO,
  TRANSPORT_TABLE_FIELDS = TRANSPORT_TABLE_D_ERRORS + TRANSPORT_TABLE_REGIONS
};

enum { TRANSPORT_TABLE_HEADER_BYTES = 24 + 8 * TRANSPORT_TABLE_FIELDS };

enum transport_table_side {
  TRANSPORT_TABLE_BELOW_1,
  TRANSPORT_TABLE_FROM_1,
  TRANSPORT_TABLE_SIDES
};

/* An opened table. `packed` is a copy of the coefficients, about a megabyte, in the order in which they
 * are summed. */
typedef struct transport_table {
  double field[TRANSPORT_TABLE_FIELDS];
  struct transport_packed *packed;
} transport_table;

/* Opens a table, which `make tables` has written, in some milliseconds. Returns false if the bytes have
 * another length, version or checksum, or if memory runs out; then *table must not be used. They may
 * have any alignment. The caller closes it with transport_table_close(). */
bool transport_table_open(transport_table *table, const uint8_t *bytes, size_t length);
void transport_table_close(transport_table *table);

/* The bytes of transport.table, which the assembler takes up into the program's read-only data. */
#pragma GCC visibility push(hidden)
extern const uint8_t transport_table_data[], transport_table_data_end[];
#pragma GCC visibility pop

/* Returns the table that is part of the program, or NULL if it is damaged or the first caller
 * lacked memory. It is mapped read-only with the program, and all processes share it. Any thread may
 * call this at any time. */
const transport_table *transport_table_shipped(void);

/* Returns whether the table covers a medium with this albedo, g and eta: albedos reach to 1, beyond
 * TRANSPORT_TABLE_ALBEDO_MOST by extrapolation, whose error is up to 5e-6 more. Any numbers may be passed. */
bool transport_table_covers(const transport_table *table, double albedo, double g, double eta);

/* Returns the largest relative error of R for radii from x_least to x_most, where R is above
 * TRANSPORT_TABLE_R_LEAST. Of isotropic scattering, this is the error for all media and radii, and
 * that of the total as well. x_least: 0 to x_most. x_most: up to infinity. */
double transport_table_error(const transport_table *table, double albedo, double g, double eta,
                             double x_least, double x_most);

/* Returns the largest relative error of the total. */
double transport_table_total_error(const transport_table *table, double g);

/* By how much a medium differs from the one with the same albedo and eta that scatters
 * isotropically: Chebyshev series in ln x. */
typedef struct transport_difference {
  double edge[TRANSPORT_TABLE_PANELS + 1]; /* edges of the panels, in ln x */
  size_t terms[TRANSPORT_TABLE_PANELS];
  double term[TRANSPORT_TABLE_PANELS][TRANSPORT_TABLE_TERMS_MAX];
  double last_slope; /* slope by ln x at the last edge */
} transport_difference;

/* One medium of the table: Chebyshev series in ln x of isotropic scattering, and the difference. */
typedef struct transport_series {
  double g;
  double kappa; /* the rate at which diffuse light decays far away */
  double total; /* the energy that leaves, per power that has entered at right angles */
  double ln_albedo;
  double edge[TRANSPORT_TABLE_PANELS + 1]; /* edges in ln x; the last one is the reach */
  size_t terms[TRANSPORT_TABLE_PANELS];
  double term[TRANSPORT_TABLE_PANELS][TRANSPORT_TABLE_TERMS_MAX];
  transport_difference difference; /* set if g is not 0 */
} transport_series;

/* Sets *series to the series of a medium, which the table has to cover (asserted). The result has
 * the same bits on every machine. */
void transport_table_look_up(const transport_table *table, double albedo, double g, double eta,
                             transport_series *series);

/* The table reduced to one g and eta: series in the albedo's coordinate alone. Looking up an albedo
 * in it takes microseconds. About a megabyte. */
typedef struct transport_slice transport_slice;

/* Creates the slice of a g and eta, which the table has to cover (asserted). Returns NULL if memory
 * runs out. The caller frees it with free(). */
transport_slice *transport_slice_create(const transport_table *table, double g, double eta);

/* Does the same as transport_table_look_up() for the slice's g and eta, for an albedo up to the table's
 * largest one. The albedo has to be covered (asserted). kappa: that of the medium (transport_anisotropic_kappa()), if g is
 * not 0. */
void transport_slice_look_up(const transport_slice *slice, double albedo, double kappa,
                             transport_series *series);

/* Returns the share that leaves of the light that entered, as diffuse light or by a beam at right
 * angles. The table has to cover the albedo; g may be 0. */
double transport_slice_total(const transport_slice *slice, bool diffuse, double albedo);

/* Returns ln(x R) + kappa x at y = ln x. */
double transport_series_at(const transport_series *series, double y);

/* Sets Q[i] to Q with the medium's own kappa at y[i] = ln x, in ascending order, for any y: the part
 * for isotropic scattering is constant outside of its panels. It is the series without its source
 * and its decay. */
void transport_series_Q(const transport_series *series, size_t n, const double *y, double *Q);

/* Makes the series of neighbouring panels meet: adds to each one a line, such that both have the mean
 * of their values at the edge between them, and the value at the other edge stays. Jumps there would
 * be smaller than the table's error, but a table of the profile (core/lut) could not follow them.
 * terms: `count` (at least 2) for each panel, of Chebyshev or Legendre polynomials. */
void transport_join_panels(size_t panels, size_t count, double *terms);

/* ---- for making tables --------------------------------------------------------------------- */

/* These convert between albedo and t or u, between g and w, and between eta and its side and v, as the
 * table's first comment defines them. */
double transport_table_t(double albedo);
double transport_table_albedo(double t);
double transport_table_u(double albedo);
double transport_table_albedo_of_u(double u);
double transport_table_w(double g);
double transport_table_g(double w);
enum transport_table_side transport_table_side(double eta);
double transport_table_v(double eta);
double transport_table_eta(enum transport_table_side side, double v);

/* Sets range[0] to the v of eta = 1, which is 0, and range[1] to the other end of v on this side.
 */
void transport_table_v_range(const double *field, enum transport_table_side side, double range[2]);

/* Sets edge to the edges in ln x, of the part for isotropic scattering or of D. kappa: that of
 * isotropic scattering with the same albedo. */
void transport_table_edges(const double *field, bool of_difference, double kappa,
                           double edge[TRANSPORT_TABLE_PANELS + 1]);

/* Returns the region of the table's errors that a medium and a radius belong to: bands of g end at
 * -0.25, 0.6 and 0.85, bands of the albedo at 1 / 11, 0.5, 0.9 and 0.999 (sigma_a / sigma_s' = 10, 1,
 * 0.11, 0.001), of eta at 1.5, of x at 0.05, 1, 10, 20 and 100. A number at the end of a band belongs
 * to the next one. */
size_t transport_table_albedo_band(double albedo);
double transport_table_albedo_end(size_t band); /* the albedo at which a band ends */
size_t transport_table_region(double albedo, double g, double eta, double x);

/* Returns the checksum of `length` bytes, which in a table are those from byte 24 to the end. */
uint64_t transport_table_checksum(const uint8_t *bytes, size_t length);

#endif
