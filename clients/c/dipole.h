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
 * A client is one connection and belongs to one thread at a time; use one client for each thread.
 * There is no global state, and nothing here ends the program: errors are values. Functions that return bool return
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
  DIPOLE_ERROR_CONNECTION, /* the connection was lost or timed out, and see dipole_set_retry_ms();
                              the client can only be closed */
  DIPOLE_ERROR_PROTOCOL,   /* the peer does not speak this protocol; likewise */
  DIPOLE_ERROR_MEMORY,     /* out of memory; within an answer: the client can only be closed */
  DIPOLE_ERROR_ARGUMENT,   /* the call's arguments do not fit together */
  DIPOLE_ERROR_REFUSED,    /* the daemon refused the request; the client goes on working */
  DIPOLE_ERROR_TABLE,      /* the bytes are not an intact table of a layout that is known here */
  DIPOLE_ERROR_STOPPED,    /* the caller wanted no more of an answer; the client goes on working */
  DIPOLE_ERROR_TIMEOUT,    /* the call took longer than call_timeout_ms; likewise */
  DIPOLE_ERROR_FULL,       /* in_flight_max queries are outstanding; likewise */
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
 * or several of unix: and tcp:, separated by commas without blanks (a comma that none of these
 * words follows is part of a path): see "several daemons" below.
 * *client is to be closed with dipole_close(). On failure it is NULL; kind REFUSED then means that
 * the daemon did not take the connection, for example because it has too many. */
bool dipole_open(const char *address, dipole_client **client, dipole_error *error);

/* What dipole_options_init() sets. */
#define DIPOLE_CONNECT_TIMEOUT_MS 10000
#define DIPOLE_TIMEOUT_MS 30000
#define DIPOLE_RETRY_MS 5000
#define DIPOLE_IN_FLIGHT_MAX 4096

/* How a client connects, how long it waits, and how much it lets wait. */
typedef struct dipole_options {
  /* Connecting to an address until the daemon has said hello takes no longer than this; 0: no
   * limit. Of private: addresses timeout_ms holds instead. Finding a host's addresses by its name
   * comes before that, and has the system's own limit. Default: 10000. */
  unsigned connect_timeout_ms;
  /* A call waits for so long without any byte arriving or leaving; 0: for ever. Then the connection
   * is given up. Default: 30000. */
  unsigned timeout_ms;
  /* No call but dipole_mc() takes longer than this, reconnecting included; 0: no limit. Then it
   * fails with kind TIMEOUT and the client goes on working: what was submitted is still
   * outstanding, the answer to anything else is thrown away when it comes. The daemon is not told
   * (see deadline_ms of a query). Default: 0. */
  unsigned call_timeout_ms;
  /* See dipole_set_retry_ms(); of private: addresses 0 holds. Default: 5000. */
  unsigned retry_ms;
  /* Opening is tried again for so long while nobody answers or all are busy, with the pauses of
   * dipole_set_retry_ms(); 0: each address is tried once. Default: 0. */
  unsigned open_ms;
  /* dipole_submit() fails with kind FULL when so many queries are outstanding; 0: no limit.
   * Default: 4096. */
  unsigned in_flight_max;
  /* Of several addresses the first one that is tried is chosen at random, so that many clients
   * spread over them. Default: false, the first one in the list. */
  bool spread;
  unsigned reserved[8]; /* 0 */
} dipole_options;

void dipole_options_init(dipole_options *options);

/* dipole_open() with other options than the default ones; options may be NULL. */
bool dipole_open_with(const char *address, const dipole_options *options, dipole_client **client,
                      dipole_error *error);

/* dipole_open() with both timeout_ms and connect_timeout_ms set to timeout_ms. */
bool dipole_open_within(const char *address, unsigned timeout_ms, dipole_client **client,
                        dipole_error *error);

/* Change an option for the calls that follow. */
void dipole_set_timeout_ms(dipole_client *client, unsigned timeout_ms);
void dipole_set_call_timeout_ms(dipole_client *client, unsigned call_timeout_ms);

/* Unanswered requests are kept, up to so many bytes in all, to be sent again. */
#define DIPOLE_RETRY_KEPT_BYTES ((size_t)64 << 20)

/* Sets how long a request that meets trouble is tried again; 0, which is the default of private:
 * addresses, means not at all. It holds for requests from the next one on.
 *
 * Trouble is a connection that is lost or that the daemon ends (SHUTTING_DOWN, TIMEOUT), and the
 * answers BUSY and SHUTTING_DOWN. The client then connects again, with pauses from 10 ms on,
 * doubled up to 1 s, shortened at random by up to a half, and sends all that is outstanding again,
 * with the same ids, what is left of its deadline, and not before the daemon's retry_after_ms. What
 * has no answer retry_ms after its first trouble fails as it would have done at once: with
 * CONNECTION, or REFUSED.
 *
 * Only what has the same one right answer whoever gives it is asked again: all requests but those
 * of dipole_mc(), whose photons would be lost. No answer is wrong or comes twice. The connection
 * is given up, and all outstanding requests with it, when it is lost while one of them cannot be
 * asked again: one of dipole_mc(); one of dipole_eval_parts() of which parts have been handed on;
 * one that DIPOLE_RETRY_KEPT_BYTES have no room for; likewise when the daemon that is there now
 * does not have the same lists (see dipole_get_info(), which goes on to tell of the first one). A
 * daemon that stays connected and silent for the timeout is not asked again.
 *
 * Several daemons. Of several addresses the first one that answers is connected to. When that
 * connection is lost, or its daemon stays silent for the timeout, the next one in the list is tried,
 * then the one after it, and after the last one the first again; the pauses above are made before
 * each such round. An address that does not answer costs no more of retry_ms (or of open_ms) than
 * its share, so that every address has its turn. What was outstanding is sent again to the daemon
 * that is found: daemons of the same version give the same bits, on every machine. One with other
 * lists is passed over. The client stays with the daemon that it has found for as long as that
 * answers. */
void dipole_set_retry_ms(dipole_client *client, unsigned retry_ms);

/* At most so many addresses can be named. */
#define DIPOLE_ADDRESSES_MAX 16

/* The address of the daemon that the client is connected to now, or tries next; owned by the
 * client. */
const char *dipole_address(const dipole_client *client);

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
  DIPOLE_DRAW,
  DIPOLE_LENGTH,
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
  const char *address; /* as connected to; of several the one that answered first */
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
enum { DIPOLE_ANY_MODEL = 0 }; /* see dipole_query.model */
enum dipole_evaluator {
  DIPOLE_F64 = 1, /* computes, in double precision */
  DIPOLE_F32 = 2, /* in single precision */
  DIPOLE_LUT = 3  /* looks up in a table, in single precision; the parameter tolerance is what the
                     table is built to, from 1e-6; 1e-4 if not given */
};
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
  /* dipole_id(client, DIPOLE_MODEL, name), or DIPOLE_ANY_MODEL: the cheapest model and evaluator
   * that are measured to be within the parameter `tolerance` of radiative transport, for all media,
   * from the smallest to the largest radius asked for. The result names what was taken. */
  unsigned model;
  unsigned evaluator; /* enum dipole_evaluator: also the type of radii and values; of any model no
                         more than that: DIPOLE_F32 and DIPOLE_LUT then mean the same */
  unsigned moments;   /* enum dipole_moments */
  unsigned wanted;    /* sum of enum dipole_quantity; DIPOLE_RADIUS returns a grid's radii */
  const dipole_medium *media; /* [medium_count], one for each channel */
  uint32_t medium_count;
  unsigned spacing;  /* enum dipole_spacing */
  const void *radii; /* list: [radius_count] of double (f64) or float, mm, 0 to infinity */
  uint64_t radius_count;
  double radius_start_mm;             /* linear, logarithmic: the first radius */
  double radius_stop_mm;              /* and the last */
  const dipole_parameter *parameters; /* [parameter_count], each id at most once; NULL: none */
  size_t parameter_count;
  /* After so many ms the daemon answers with an error of kind REFUSED, status `deadline`, instead
   * of a later result; they count from the arrival of the query. 0: no matter. */
  unsigned deadline_ms;
  /* NULL: the result holds its arrays. Otherwise they are received where the caller wants them:
   * into_values is [medium_count][quantities wanted that have an array][radius_count] of double or
   * float, the quantities in the order of enum dipole_quantity, and into_radii [radius_count] if
   * DIPOLE_RADIUS is wanted. Both are the caller's, must not be touched until the query has been
   * collected, refused or given up or the client is closed, and hold nothing of use unless the call
   * that hands out the result succeeds. dipole_eval_parts() does not use them. */
  void *into_values;
  void *into_radii;
} dipole_query;

/* The answer for one medium. An array is NULL when its quantity was not wanted or when the
 * evaluator has the other type: *_f64 are of DIPOLE_F64, *_f32 of the others. */
typedef struct dipole_channel {
  double albedo; /* NaN when not wanted */
  /* A value at radius r is off from the model's formula by at most
   * numerical_error + numerical_error_per_mm * r, relative. */
  double numerical_error;
  double numerical_error_per_mm;
  double model_error;    /* of the model against radiative transport, relative; NaN: not measured;
                            of DIPOLE_ANY_MODEL: for the radii asked for */
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
 * dipole_result_free(). Answers to submitted queries that arrive meanwhile are kept. An answer of
 * any size is one result, as large as memory allows. */
bool dipole_eval(dipole_client *client, const dipole_query *query, dipole_result **result,
                 dipole_error *error);

/* Evaluates like dipole_eval(), but keeps nothing: whatever the daemon sends at a time is handed to
 * part() as soon as it is here, so that an answer may be larger than memory. How many radii come at
 * a time is the daemon's choice; an answer that fits into a frame (limit max_frame_bytes) is one
 * part, of a larger one parts have up to max_part_bytes.
 *
 * part() is called for one part after the other. *part is a result of its own, for the
 * part->radius_count radii that begin at position radius_first of those asked for; its arrays hold
 * these, and all else is the same in every part. It is valid until the function returns, which must
 * neither free it nor use the client. While it works the daemon waits.
 *
 * True: all parts have been there. False: an error ended the answer; what had come before is right,
 * and part() may have been called for it. When part() returns false the error is of kind STOPPED;
 * the client goes on working, but the next calls have to wait until the rest has come, and throw it
 * away: where much of it is left it is better to close the client. */
bool dipole_eval_parts(dipole_client *client, const dipole_query *query,
                       bool (*part)(void *context, const dipole_result *part,
                                    uint64_t radius_first),
                       void *context, dipole_error *error);

void dipole_result_free(dipole_result *result); /* NULL is fine */

/* The array of any quantity that has a value for each radius (all but albedo and, but for
 * dipole_sample(), radius): [radius_count], owned by the result. NULL when it was not wanted, when
 * the evaluator has the other type, or when there is no such channel. For R and cdf the channel's
 * own fields say the same. */
const double *dipole_values_f64(const dipole_result *result, uint32_t channel, unsigned quantity);
const float *dipole_values_f32(const dipole_result *result, uint32_t channel, unsigned quantity);

/* ---- many at once -------------------------------------------------------------------------- */

/* Queries can be sent without waiting for the answers to those before, and their answers collected
 * in any order:
 *
 *   for (i = 0; i < n; i++) { dipole_submit(client, &queries[i], &ids[i], &error) ... }
 *   for (i = 0; i < n; i++) { dipole_collect(client, &id, &result, &error) ... }
 *
 * What arrives meanwhile is received by whatever call waits, also by dipole_submit() when the
 * daemon takes no more: so that a program that submits without collecting cannot make both sides
 * wait for each other. It costs the memory of the answers instead, which in_flight_max bounds. A
 * program that does not call the library for a while is waited for by the daemon. */

/* Submits a query and sets *id, which is never 0. The query is copied, its radii too; into_values and
 * into_radii are kept. False with kind FULL: in_flight_max queries are outstanding; with kind
 * TIMEOUT: the query was not submitted. */
bool dipole_submit(dipole_client *client, const dipole_query *query, uint64_t *id,
                   dipole_error *error);

/* Sends what has been submitted and is held back: up to a quarter of the outstanding queries, and
 * 16 KiB, are, until a call waits. For a program that now does something else for a while. */
void dipole_flush(dipole_client *client);

/* Waits for the answer to any outstanding query, the one that comes next, and sets *id to it. False
 * with kind REFUSED: the query *id was refused, others go on. False with kind TIMEOUT: none has come
 * in time, all go on. False with kind ARGUMENT: nothing is outstanding. */
bool dipole_collect(dipole_client *client, uint64_t *id, dipole_result **result,
                    dipole_error *error);

/* Likewise for the answer to one outstanding query. False with kind ARGUMENT: there is none with
 * this id. */
bool dipole_collect_id(dipole_client *client, uint64_t id, dipole_result **result,
                       dipole_error *error);

/* How many queries have been submitted and not been collected. */
size_t dipole_outstanding(const dipole_client *client);

/* ---- the trade between speed and accuracy -------------------------------------------------- */

/* A model and evaluator that could answer a query. */
typedef struct dipole_offer {
  unsigned model;     /* id of the daemon's list */
  unsigned evaluator; /* enum dipole_evaluator */
  bool meets;         /* the parameter tolerance; false: not, or not known to */
  double error;       /* relative, against radiative transport, for the query's radii, all of its
                         media and all that is wanted; INFINITY: not known */
  double numerical_error; /* the share of that which is the evaluator's; of a table: asked of it */
  double cost_ns;         /* of a value, as measured once, on one machine */
  double prepare_ns;      /* of a medium, likewise */
} dipole_offer;

/* What could answer a query whose model is DIPOLE_ANY_MODEL, cheapest first: *offers is an array
 * for the caller to free(). Of listed radii only the range matters. *taken (which may be NULL) is
 * the position of the one that dipole_eval() would take; *count: none. */
bool dipole_offers(dipole_client *client, const dipole_query *query, dipole_offer **offers,
                   size_t *count, size_t *taken, dipole_error *error);

/* ---- drawing radii ------------------------------------------------------------------------- */

/* How the numbers u of a query are given; i from 0 to sample_count - 1. */
enum dipole_draw {
  DIPOLE_DRAW_LIST = 1,       /* by numbers */
  DIPOLE_DRAW_REGULAR = 2,    /* (i + 1/2) / sample_count */
  DIPOLE_DRAW_STRATIFIED = 3, /* (i + random number i of the seed) / sample_count */
  DIPOLE_DRAW_RANDOM = 4      /* random number sample_first + i of the seed */
};

typedef struct dipole_sample_query {
  unsigned model;     /* dipole_id(client, DIPOLE_MODEL, name); one that covers all radii */
  unsigned evaluator; /* enum dipole_evaluator: also the type of numbers, radii and values */
  unsigned moments;   /* enum dipole_moments */
  unsigned wanted; /* sum of enum dipole_quantity: DIPOLE_RADIUS are the radii that are drawn; all
                         others are evaluated at them */
  const dipole_medium *media; /* [medium_count], one for each channel */
  uint32_t medium_count;
  unsigned draw;       /* enum dipole_draw: the numbers are the same for all channels */
  const void *numbers; /* list: [sample_count] of double (f64) or float, 0 to 1, both included */
  uint64_t sample_count;
  uint64_t sample_first; /* random; 0 to 2^52 */
  uint64_t seed;         /* random, stratified: the same seed gives the same bits everywhere */
  const dipole_parameter *parameters; /* [parameter_count], as of an eval */
  size_t parameter_count;
  unsigned deadline_ms; /* as of an eval */
} dipole_sample_query;

/* Draws radii in proportion to r R(r): the radius for each number u is the one with cdf(r) = u, 0
 * mm for 0 and INFINITY for 1. Its pdf (DIPOLE_PDF) is in 1/mm; pdf / (2 pi r) is the density of
 * points per mm^2. Waits for the answer, in which radius_count is sample_count, dipole_values_f64()
 * or ..._f32() with DIPOLE_RADIUS are the radii of a channel, and radius_f64 and radius_f32 are
 * NULL. *result is the caller's, to be freed with dipole_result_free(). */
bool dipole_sample(dipole_client *client, const dipole_sample_query *query, dipole_result **result,
                   dipole_error *error);

/* The numbers begin, ..., begin + n - 1 of a query that has them by rule, without a daemon: u[n] of
 * double (f64) or float, the bits that the daemon draws with. False: there are none such. */
bool dipole_sample_numbers(const dipole_sample_query *query, uint64_t begin, size_t n, void *u,
                           dipole_error *error);

/* ---- from albedos to coefficients ---------------------------------------------------------- */

/* Which length of a medium is known; sigma_t' = sigma_a + sigma_s (1 - g). */
enum dipole_length {
  DIPOLE_MEAN_FREE_PATH = 1, /* 1 / sigma_t' */
  DIPOLE_DIFFUSE_MEAN_FREE_PATH =
      2,                            /* 1 / (sigma_t' sqrt(3 a / (1 + a))), a = sigma_a / sigma_t' */
  DIPOLE_CLASSICAL_DIFFUSE_PATH = 3 /* 1 / sqrt(3 sigma_a sigma_t') */
};

typedef struct dipole_invert_query {
  unsigned model;   /* whose albedo is known; one whose albedo depends on the medium */
  unsigned moments; /* enum dipole_moments */
  unsigned given;   /* enum dipole_length */
  double g, eta;    /* of all media */
  const double
      *albedos; /* [medium_count], 0 to 1: integral of 2 pi r R(r), per power that entered */
  const double *lengths_mm; /* [medium_count], 1e-14 to 1e14 */
  uint64_t medium_count; /* at least 1; as many as a frame has room for, see max_frame_bytes; of a
                               model that takes long to prepare (transport: seconds for each), up to
                               the limit max_media */
  unsigned deadline_ms;  /* as of an eval */
} dipole_invert_query;

/* Arrays: [medium_count], in the order of the query; NaN where there is no such medium. */
typedef struct dipole_inversion {
  uint64_t medium_count;
  uint64_t missing_count; /* how many there are not */
  const double *sigma_a_per_mm;
  const double *sigma_s_per_mm;
  const double
      *albedos;        /* of these media: within 1e-12 of what was wanted, relative, or a few units
                            of the last place of what the model resolves */
  double albedo_least; /* what the model can reach with this g and eta: an albedo that is not */
  double
      albedo_most; /* between these has no medium, nor has one without absorption a diffuse path */
} dipole_inversion;

/* Finds the media that have the given albedos and lengths, and waits for the answer. *inversion is
 * the caller's, to be freed with dipole_inversion_free(). */
bool dipole_invert(dipole_client *client, const dipole_invert_query *query,
                   dipole_inversion **inversion, dipole_error *error);

void dipole_inversion_free(dipole_inversion *inversion); /* NULL is fine */

/* ---- tables -------------------------------------------------------------------------------- */

/* The table of one medium by which the evaluator DIPOLE_LUT works, to be evaluated here: without a
 * daemon, and with the same bits. Nothing changes a table once it is there: any number of threads
 * may evaluate it at the same time. */
typedef struct dipole_table dipole_table;

typedef struct dipole_table_query {
  unsigned model;   /* dipole_id(client, DIPOLE_MODEL, name) */
  unsigned moments; /* enum dipole_moments */
  dipole_medium medium;
  const dipole_parameter *parameters; /* [parameter_count], as of an eval: tolerance, ... */
  size_t parameter_count;
  unsigned deadline_ms; /* as of an eval */
} dipole_table_query;

/* What holds for all values of a table; owned by the table and valid until it is freed. */
typedef struct dipole_table_info {
  unsigned layout; /* of the words: proto/PROTOCOL.md, "table" */
  unsigned model, moments;
  unsigned notes; /* sum of the ids of the choices of kind DIPOLE_NOTE that hold */
  dipole_medium medium;
  const dipole_parameter *parameters; /* [parameter_count]: those of the query */
  size_t parameter_count;
  double albedo; /* integral of 2 pi r R(r) over all radii */
  /* A value at radius r is off from the model's formula by at most
   * numerical_error + numerical_error_per_mm * r, relative, as measured between all nodes. */
  double numerical_error;
  double numerical_error_per_mm;
  double model_error;    /* of the model against radiative transport, relative; NaN: not measured */
  double pieces_from_mm; /* between these two radii there are pieces; outside, known asymptotes */
  double pieces_to_mm;
  double radius_least_mm; /* the radii that the model covers, both included */
  double radius_most_mm;
  const uint32_t *words; /* [word_count]: single precision numbers and entries, as bits */
  size_t word_count;
} dipole_table_info;

/* Fetches a table from a daemon. *table is the caller's, to be freed with dipole_table_free(). */
bool dipole_table_fetch(dipole_client *client, const dipole_table_query *query,
                        dipole_table **table, dipole_error *error);

/* A table from bytes that dipole_table_bytes() gave, at any alignment; they are copied. What stands
 * behind the table's own bytes is not looked at: so a file may hold several, one behind the other.
 * Damaged bytes, and those of another layout, are errors of kind TABLE: whatever they say, nothing
 * outside of the table will be read. *table is the caller's, to be freed with
 * dipole_table_free(). */
bool dipole_table_load(const void *bytes, size_t count, dipole_table **table, dipole_error *error);

/* The table as bytes, to be saved: count of them, owned by the table. It is the daemon's reply, a
 * whole frame, the same on every machine. */
const void *dipole_table_bytes(const dipole_table *table, size_t *count);

const dipole_table_info *dipole_table_get_info(const dipole_table *table);

/* Evaluates one of DIPOLE_R, DIPOLE_CDF, DIPOLE_PDF, DIPOLE_RING and, for the parameters cos_in and
 * cos_out of the query, DIPOLE_S: r[n] in mm, from 0 to infinity; out[n] in the quantity's unit;
 * the arrays do not overlap. False, with out as it was: the table does not hold that quantity, or a
 * radius is NaN, negative or not covered by the model. */
bool dipole_table_values(const dipole_table *table, enum dipole_quantity quantity, size_t n,
                         const float *r, float *out);

/* Radii for drawing: r[n] in mm such that cdf(r) = u, for u[n] from 0 to 1 (infinity), both
 * included; the arrays do not overlap. 0 where nothing scatters. False, with r as it was: a u is
 * none of those. */
bool dipole_table_radii(const dipole_table *table, size_t n, const float *u, float *r);

void dipole_table_free(dipole_table *table); /* NULL is fine */

/* The radii r[count], mm, of a linear or logarithmic grid, as a daemon takes them in single
 * precision: for evaluating a table where a query would have a grid. */
bool dipole_grid_radii(enum dipole_spacing spacing, double start_mm, double stop_mm, uint64_t count,
                       float *r, dipole_error *error);

/* What this library knows by itself, without a daemon: the lists and instruction set by which it
 * evaluates tables. address is "". One block for the caller to free(). */
bool dipole_local_info(dipole_info **info, dipole_error *error);

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
