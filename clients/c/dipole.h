/* libdipole: ask a dipoled for subsurface-scattering profiles R(r).
 *
 *   dipole_client *client;
 *   dipole_error error;
 *   if (!dipole_open(NULL, &client, &error)) { puts(error.text); ... }
 *   dipole_medium skin = {.sigma_a_per_mm = 0.032, .sigma_s_per_mm = 0.74, .g = 0, .eta = 1.3};
 *   double r[2] = {0.5, 1.0};
 *   dipole_query query = {.model = dipole_id(client, DIPOLE_MODEL, "better"),
 *                         .evaluator = DIPOLE_F64, .moments = DIPOLE_EXACT,
 *                         .wanted = DIPOLE_R | DIPOLE_CDF,
 *                         .media = &skin, .medium_count = 1,
 *                         .spacing = DIPOLE_LIST, .radii = r, .radius_count = 2};
 *   dipole_result *result;
 *   if (!dipole_eval(client, &query, &result, &error)) { ... }
 *   printf("%g 1/mm^2\n", result->channels[0].R_f64[1]);
 *   dipole_result_free(result);
 *   dipole_close(client);
 *
 * Units: lengths in mm, coefficients in 1/mm, R in 1/mm^2 per unit of power that entered the
 * medium.
 *
 * A client belongs to one thread at a time; use one client for each thread. There is no global
 * state, and nothing here ends the program: errors are values. Functions that return bool return
 * false on failure and then fill *error (which may be NULL).
 */
#ifndef DIPOLE_H
#define DIPOLE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct dipole_client dipole_client;

/* ---- errors -------------------------------------------------------------------------------- */

enum dipole_error_kind {
  DIPOLE_ERROR_NONE = 0,
  DIPOLE_ERROR_ADDRESS,    /* the address cannot be understood */
  DIPOLE_ERROR_CONNECT,    /* nobody answers there */
  DIPOLE_ERROR_CONNECTION, /* the connection was lost or timed out; the client can only be closed */
  DIPOLE_ERROR_PROTOCOL,   /* the peer does not speak this protocol; likewise */
  DIPOLE_ERROR_MEMORY,     /* out of memory; within an answer: the client can only be closed */
  DIPOLE_ERROR_ARGUMENT,   /* the call's arguments do not fit together */
  DIPOLE_ERROR_REFUSED,    /* the daemon refused the request; the client goes on working */
};

typedef struct dipole_error {
  enum dipole_error_kind kind;
  unsigned status;         /* REFUSED: the daemon's status code */
  uint64_t index;          /* REFUSED: the position of the value at fault in its array */
  char field[33];          /* REFUSED: the field at fault, or "" */
  char allowed[81];        /* REFUSED: what is allowed there, or "" */
  uint32_t retry_after_ms; /* REFUSED because the daemon is busy: when to try again; else 0 */
  char text[256];          /* the whole of it in words, for people */
} dipole_error;

/* ---- connecting ---------------------------------------------------------------------------- */

/* Connects, agrees on a protocol version and reads the daemon's lists. address is one of
 *   unix:PATH          a Unix socket
 *   tcp:HOST:PORT      TCP ([::1]:PORT for IPv6)
 *   private:           starts a dipoled of its own that ends with the client; the program is found
 *                      beside the running one, then in $PATH
 *   private:PROGRAM    the same, with this program
 *   NULL               $DIPOLED when that is set, else private:
 * *client is to be closed with dipole_close(). On failure it is NULL; kind REFUSED then means that
 * the daemon did not take the connection, for example because it has too many. */
bool dipole_open(const char *address, dipole_client **client, dipole_error *error);

/* How long a call waits at first without any byte arriving or leaving. */
#define DIPOLE_TIMEOUT_MS 30000

/* dipole_open() with another timeout, which also holds for connecting; 0: for ever. */
bool dipole_open_within(const char *address, unsigned timeout_ms, dipole_client **client,
                        dipole_error *error);

/* Changes the timeout of the calls that follow. */
void dipole_set_timeout_ms(dipole_client *client, unsigned timeout_ms);

/* Closes the connection, ends a private daemon, frees the client. NULL is fine. */
void dipole_close(dipole_client *client);

/* ---- what the daemon offers ---------------------------------------------------------------- */

enum dipole_kind {
  DIPOLE_MODEL = 1,
  DIPOLE_EVALUATOR,
  DIPOLE_MOMENTS,
  DIPOLE_QUANTITY,
  DIPOLE_SPACING,
  DIPOLE_STATUS,
  DIPOLE_PARAMETER,
  DIPOLE_NOTE,
};

typedef struct dipole_choice {
  enum dipole_kind kind;
  unsigned id;
  const char *name;
  const char *about; /* source of a model, unit of a quantity, meaning of anything else (of a
                        parameter: unit, meaning and range) */
} dipole_choice;

typedef struct dipole_value {
  const char *name; /* unit last: max_frame_bytes */
  uint64_t value;
} dipole_value;

/* What the daemon said of itself; owned by the client and valid until it is closed. */
typedef struct dipole_info {
  const char *address; /* as connected to */
  const char *software;
  const char *instruction_set;
  const char *R_unit;
  unsigned protocol_version;
  unsigned workers;
  const dipole_choice *choices;
  size_t choice_count;
  const dipole_value *limits;
  size_t limit_count;
} dipole_info;

const dipole_info *dipole_get_info(const dipole_client *client);

/* The id of the choice of this kind with this name; 0: the daemon has none (only the
 * status ok has the id 0). */
unsigned dipole_id(const dipole_client *client, enum dipole_kind kind, const char *name);

/* ---- evaluating ---------------------------------------------------------------------------- */

/* Ids that are permanent; models are asked for by name, see dipole_id(). */
enum dipole_evaluator { DIPOLE_F64 = 1, DIPOLE_F32 = 2, DIPOLE_LUT = 3 };
enum dipole_moments { DIPOLE_EXACT = 1, DIPOLE_FIT = 2, DIPOLE_JENSEN = 3 };
enum dipole_quantity {
  DIPOLE_R = 1,      /* 1/mm^2 per unit of power that entered */
  DIPOLE_ALBEDO = 2, /* one for each medium: the integral of 2 pi r R(r) */
  DIPOLE_CDF = 4,    /* the energy within r over the albedo */
  DIPOLE_RADIUS = 8, /* the radii, once: of a grid, those that were taken */
  DIPOLE_SLOPE = 16, /* dR/dr, 1/mm^3 */
  DIPOLE_LN_R = 32,  /* ln of R in 1/mm^2; goes on where R has underflowed. Its error is absolute:
                        the numerical error and 8 epsilon |ln R| */
  DIPOLE_PDF = 64,   /* the density of radii, 2 pi r R over the albedo, 1/mm */
  DIPOLE_RING = 128, /* 2 pi r R, 1/mm: the power that leaves per mm of radius; finite at r = 0,
                        where R of some models is infinite */
  DIPOLE_S = 256     /* the BSSRDF, 1/(mm^2 sr), for the parameters cos_in and cos_out */
};
enum dipole_spacing { DIPOLE_LIST = 1, DIPOLE_LINEAR = 2, DIPOLE_LOGARITHMIC = 3 };

typedef struct dipole_medium {
  double sigma_a_per_mm; /* absorption coefficient, 0 to 1e15 */
  double sigma_s_per_mm; /* scattering coefficient, 0 to 1e15 */
  double g;              /* mean cosine of the phase function, in (-1, 1) */
  double eta;            /* index inside over index outside, 0.001 to 1000 */
} dipole_medium;

/* An optional number of a query. Which there are, their units and ranges: the choices of kind
 * DIPOLE_PARAMETER; dipole_id(client, DIPOLE_PARAMETER, "cos_in"). A model refuses what it does not
 * take. */
typedef struct dipole_parameter {
  unsigned id;
  double value; /* a number: a parameter that is not wanted is left out */
} dipole_parameter;

typedef struct dipole_query {
  unsigned model;     /* dipole_id(client, DIPOLE_MODEL, name) */
  unsigned evaluator; /* enum dipole_evaluator: also the type of radii and values */
  unsigned moments;   /* enum dipole_moments */
  unsigned wanted;    /* sum of enum dipole_quantity; DIPOLE_RADIUS returns a grid's radii */
  const dipole_medium *media; /* [medium_count], one for each channel */
  uint32_t medium_count;
  unsigned spacing;  /* enum dipole_spacing */
  const void *radii; /* list: [radius_count] of double (f64) or float (others), mm, 0 to infinity */
  uint64_t radius_count;
  double radius_start_mm;             /* linear, logarithmic: the first radius */
  double radius_stop_mm;              /* and the last */
  const dipole_parameter *parameters; /* [parameter_count], each id at most once; NULL: none */
  size_t parameter_count;
} dipole_query;

/* The answer for one medium. An array is NULL when its quantity was not wanted or when the
 * evaluator's values have the other type: f64's are double, all others' are float. */
typedef struct dipole_channel {
  double albedo; /* NaN when not wanted */
  /* A value at radius r is off from the model's formula by at most
   * numerical_error + numerical_error_per_mm * r, relative. */
  double numerical_error;
  double numerical_error_per_mm;
  double model_error;    /* of the model against radiative transport, relative; NaN: not measured */
  const double *R_f64;   /* [radius_count], 1/mm^2 */
  const double *cdf_f64; /* [radius_count] */
  const float *R_f32;
  const float *cdf_f32;
} dipole_channel;

typedef struct dipole_result {
  unsigned model, evaluator, moments, wanted; /* as taken by the daemon */
  unsigned notes; /* sum of the ids of the choices of kind DIPOLE_NOTE that hold for a channel */
  uint64_t radius_count;
  const double *radius_f64; /* [radius_count], mm; NULL unless DIPOLE_RADIUS was wanted */
  const float *radius_f32;
  uint32_t channel_count;
  const dipole_channel *channels; /* [channel_count], in the order of the query's media */
} dipole_result;

/* Evaluates and waits for the answer. *result is the caller's, to be freed with
 * dipole_result_free(). Answers to submitted queries that arrive meanwhile are kept. */
bool dipole_eval(dipole_client *client, const dipole_query *query, dipole_result **result,
                 dipole_error *error);

void dipole_result_free(dipole_result *result); /* NULL is fine */

/* The array of any quantity that has a value for each radius (all but albedo and radius):
 * [radius_count], owned by the result. NULL when it was not wanted, when the evaluator's values
 * have the other type, or when there is no such channel. For R and cdf the channel's own fields say
 * the same. */
const double *dipole_values_f64(const dipole_result *result, uint32_t channel, unsigned quantity);
const float *dipole_values_f32(const dipole_result *result, uint32_t channel, unsigned quantity);

/* Sends a query without waiting and sets *id. The query is copied. Keep the number of outstanding
 * queries bounded (a few hundred): the daemon stops reading from a client that does not collect. */
bool dipole_submit(dipole_client *client, const dipole_query *query, uint64_t *id,
                   dipole_error *error);

/* Waits for the answer to any outstanding query and sets *id to it. False with kind REFUSED: the
 * query *id was refused, others go on. False with kind ARGUMENT: nothing is outstanding. */
bool dipole_collect(dipole_client *client, uint64_t *id, dipole_result **result,
                    dipole_error *error);

/* ---- Monte Carlo --------------------------------------------------------------------------- */

/* A job for the daemon: photons that walk through a medium, until so many have been walked or the
 * errors are small enough. The same query gives the same bits, unless it is ended early. */
typedef struct dipole_mc_query {
  dipole_medium medium;
  const double *albedos;  /* [albedo_count] of single scattering, 0 to 1, in place of the medium's;
                            one walk serves all */
  unsigned albedo_count;  /* up to 16; 0: the medium's own */
  double thickness_mm;    /* of a slab; INFINITY: half space */
  unsigned spacing;       /* of the rings' edges: DIPOLE_LINEAR or DIPOLE_LOGARITHMIC */
  uint32_t ring_count;    /* 1 to 4096 */
  double radius_start_mm; /* inner edge of the first ring */
  double radius_stop_mm;  /* outer edge of the last */
  uint64_t seed;
  uint64_t photons;   /* at least 1, at most the daemon's limit max_mc_photons */
  double error_total; /* relative standard error of R that is small enough; 0: none is */
  double error_rings; /* likewise of each ring with light; with both, both must hold */
} dipole_mc_query;

enum dipole_mc_side { DIPOLE_MC_REFLECTED, DIPOLE_MC_TRANSMITTED, DIPOLE_MC_SIDES };

typedef struct dipole_mc_progress {
  uint64_t photons;          /* walked */
  uint64_t photons_expected; /* what it will take in all, as far as is known */
  double error_total;        /* relative standard error of R, the largest of all albedos */
  double error_rings;        /* likewise of a ring with light; INFINITY: not known yet */
  double worst_from_mm;      /* the edges of that ring, both 0: there is none; */
  double worst_to_mm;
  unsigned worst_side; /* where it lies, and for which albedo */
  unsigned worst_albedo;
} dipole_mc_progress;

/* A share of the power that entered the medium, and its standard error. */
typedef struct dipole_mc_value {
  double value;
  double error;
} dipole_mc_value;

/* Where the power went, for one albedo. Arrays: by side. */
typedef struct dipole_mc_energy {
  double albedo;
  dipole_mc_value R; /* leaves where light enters: unscattered, under, rings and over */
  dipole_mc_value T; /* leaves on the other side of a slab, likewise */
  dipole_mc_value absorbed;
  dipole_mc_value unfinished; /* was still inside when its walk was given up */
  dipole_mc_value roulette;   /* what roulette has added less what it has taken; 0 is expected */
  double unscattered[DIPOLE_MC_SIDES];    /* at r = 0, in no ring; exact */
  dipole_mc_value under[DIPOLE_MC_SIDES]; /* within the inner edge of the first ring */
  dipole_mc_value over[DIPOLE_MC_SIDES];  /* beyond the outer edge of the last */
  double imbalance; /* R + T + absorbed + unfinished - roulette - 1: 0 but for rounding */
} dipole_mc_energy;

enum dipole_mc_end {
  DIPOLE_MC_PHOTONS = 1, /* all photons are walked */
  DIPOLE_MC_ERRORS,      /* the errors are small enough */
  DIPOLE_MC_CANCELLED,   /* these two: the table of what had been walked */
  DIPOLE_MC_STOPPED,     /* with the daemon */
};

typedef struct dipole_mc_result {
  enum dipole_mc_end end;
  dipole_mc_progress last;
  uint32_t side_count; /* 1 for a half space, 2 for a slab */
  uint32_t albedo_count;
  uint32_t ring_count;
  const double *edges_mm;           /* [ring_count + 1] */
  const dipole_mc_energy *energies; /* [albedo_count] */
} dipole_mc_result;

/* Starts a job and waits for its table. progress: NULL, or called a few times a second; when it
 * returns false the job is cancelled, and ends with the table so far. It must not use the client.
 * *result is the caller's, to be freed with dipole_mc_result_free(). */
bool dipole_mc(dipole_client *client, const dipole_mc_query *query,
               bool (*progress)(void *context, const dipole_mc_progress *now), void *context,
               dipole_mc_result **result, dipole_error *error);

void dipole_mc_result_free(dipole_mc_result *result); /* NULL is fine */

/* [ring_count] each, owned by the result; NULL when there is no such albedo or side: the means of
 * R (or its like on the other side) over the rings, 1/mm^2 per unit of power that entered, their
 * standard errors, and how many photons left there, whatever their weight. */
const double *dipole_mc_values(const dipole_mc_result *result, uint32_t albedo,
                               enum dipole_mc_side side);
const double *dipole_mc_errors(const dipole_mc_result *result, uint32_t albedo,
                               enum dipole_mc_side side);
const uint64_t *dipole_mc_photons(const dipole_mc_result *result, enum dipole_mc_side side);

/* ---- the rest ------------------------------------------------------------------------------ */

/* A measured medium: three channels, red, green, blue. */
typedef struct dipole_measured_medium {
  char name[17];
  dipole_medium channel[3];
} dipole_measured_medium;

/* The daemon's measured media, as an array for the caller to free(). */
bool dipole_media(dipole_client *client, dipole_measured_medium **media, size_t *count,
                  dipole_error *error);

/* The daemon's statistics, as one block for the caller to free(); names point into it. */
bool dipole_statistics(dipole_client *client, dipole_value **values, size_t *count,
                       dipole_error *error);

/* A round trip that does nothing else. */
bool dipole_ping(dipole_client *client, dipole_error *error);

#ifdef __cplusplus
}
#endif

#endif
