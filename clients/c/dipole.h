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
 * A client is one connection and belongs to one thread at a time: use one client for each thread.
 * The library has no global state and never ends the program. A function that returns bool returns
 * false on failure and then fills *error; error may be NULL.
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

  /* After these the client goes on working. */
  DIPOLE_ERROR_ARGUMENT = 6, /* The call's arguments do not fit together. */
  DIPOLE_ERROR_REFUSED,      /* The daemon refused the request. */
  DIPOLE_ERROR_TABLE,        /* The bytes are not an intact table of a layout that is known here. */
  DIPOLE_ERROR_STOPPED,      /* The caller wanted no more of an answer. */
  DIPOLE_ERROR_TIMEOUT,      /* The call took longer than call_timeout_ms. */
  DIPOLE_ERROR_FULL,         /* in_flight_max queries are outstanding. */

  /* After these there is no client, or it can only be closed. */
  DIPOLE_ERROR_ADDRESS = 1, /* The address is not written as an address. */
  DIPOLE_ERROR_CONNECT,     /* Nobody answers at the address. */
  DIPOLE_ERROR_CONNECTION,  /* The connection was lost or timed out: see dipole_set_retry_ms(). */
  DIPOLE_ERROR_PROTOCOL,    /* The peer does not speak this protocol. */
  DIPOLE_ERROR_MEMORY,      /* There is no memory. The client works on unless it met an answer. */
};

typedef struct dipole_error {
  enum dipole_error_kind kind;
  /* The next four are set for kind REFUSED. */
  unsigned status;         /* the daemon's status code */
  uint64_t index;          /* position of the value at fault in its array */
  char field[33];          /* name of the field at fault, or "" */
  char allowed[81];        /* what is allowed in that field, or "" */
  uint32_t retry_after_ms; /* when to ask again if the daemon is busy; else 0 */
  char text[256];          /* all of it in words, for people */
} dipole_error;

/* ---- connecting ---------------------------------------------------------------------------- */

/* Connects, agrees on a protocol version and reads the daemon's lists. address is one of
 *   unix:PATH          a Unix socket
 *   tcp:HOST:PORT      TCP ([::1]:PORT for IPv6)
 *   private:           starts a dipoled that serves only this client and ends with it: the one
 *                      beside the running program, else the one in $PATH. It logs only errors.
 *   private:PROGRAM    the same with this program
 *   NULL               $DIPOLED if that is set, else private:
 * Several unix: and tcp: addresses may be given, separated by commas without blanks: see "Several
 * daemons" below. A comma that no unix: or tcp: follows is part of a path. The caller closes
 * *client with dipole_close(). On failure *client is NULL; kind REFUSED then means that the daemon
 * did not take the connection, for example because it has too many. */
bool dipole_open(const char *address, dipole_client **client, dipole_error *error);

/* The values that dipole_options_init() sets. */
#define DIPOLE_CONNECT_TIMEOUT_MS 10000
#define DIPOLE_TIMEOUT_MS 30000
#define DIPOLE_RETRY_MS 5000
#define DIPOLE_IN_FLIGHT_MAX 4096

/* How a client connects, how long it waits, and how many queries may be outstanding. */
typedef struct dipole_options {
  /* The longest time for connecting to an address, until the daemon has said hello; 0 is no limit.
   * private: addresses have timeout_ms as their limit instead. The system looks up a host's name
   * before that, with a limit of its own. Default: 10000. */
  unsigned connect_timeout_ms;
  /* The connection is given up when a call has waited so long without any byte arriving or leaving;
   * 0 is no limit. Default: 30000. */
  unsigned timeout_ms;
  /* The longest time for any call but dipole_mc(), reconnecting included; 0 is no limit. The call
   * then fails with kind TIMEOUT and the client goes on working. Submitted queries are still
   * outstanding; the answer to any other request is thrown away when it comes. The daemon does not
   * know this limit; it knows the deadline_ms of a query. Default: 0. */
  unsigned call_timeout_ms;
  /* See dipole_set_retry_ms(). private: addresses have 0. Default: 5000. */
  unsigned retry_ms;
  /* How long opening is tried again while nobody answers or all daemons are busy, with the pauses
   * of dipole_set_retry_ms(); 0: each address is tried once. Default: 0. */
  unsigned open_ms;
  /* dipole_submit() fails with kind FULL when so many queries are outstanding; 0 is no limit.
   * Default: 4096. */
  unsigned in_flight_max;
  /* Which of several addresses is tried first. false: the first one in the list; true: a random
   * one, so that many clients spread over the daemons. Default: false. */
  bool spread;
  unsigned reserved[8]; /* 0 */
} dipole_options;

void dipole_options_init(dipole_options *options);

/* dipole_open() with options. NULL: the default ones. */
bool dipole_open_with(const char *address, const dipole_options *options, dipole_client **client,
                      dipole_error *error);

/* dipole_open() with both timeout_ms and connect_timeout_ms set to timeout_ms. */
bool dipole_open_within(const char *address, unsigned timeout_ms, dipole_client **client,
                        dipole_error *error);

/* These change an option for the calls that follow. */
void dipole_set_timeout_ms(dipole_client *client, unsigned timeout_ms);
void dipole_set_call_timeout_ms(dipole_client *client, unsigned call_timeout_ms);

/* The most bytes of unanswered requests that are kept to be sent again. */
#define DIPOLE_RETRY_KEPT_BYTES ((size_t)64 << 20)

/* Sets how long a request that meets trouble is tried again, from the next request on. 0, the
 * default of private: addresses, is not at all.
 *
 * Trouble is a lost connection, a daemon that ends the connection (SHUTTING_DOWN, TIMEOUT), and the
 * answers BUSY and SHUTTING_DOWN. The client then connects again and sends all that is outstanding
 * again, with the same ids and what is left of the deadlines, and not before the daemon's
 * retry_after_ms. The pauses between two attempts grow from 10 ms to 1 s, doubled each time and
 * shortened at random by up to a half. A request without an answer retry_ms after its first trouble
 * fails as it would have failed at once: with CONNECTION or REFUSED.
 *
 * A request is sent again only if every daemon gives it the same answer. This holds for all
 * requests but those of dipole_mc(), whose photons would be lost. No answer is wrong or comes
 * twice.
 *
 * When the connection is lost, all outstanding requests fail with it if one of them cannot be sent
 * again. These are: a request of dipole_mc(); one of dipole_eval_parts() that has handed on a part;
 * and one for which DIPOLE_RETRY_KEPT_BYTES had no room. They also fail if the new daemon has other
 * lists: see dipole_get_info(), which goes on to describe the first daemon. If the list
 * has a single address, requests fail when its daemon stays connected and silent for timeout_ms.
 *
 * Several daemons. The client connects to the first address that answers. When that connection is
 * lost, or its daemon is silent for timeout_ms, it tries the next address in the list, and so on in
 * a circle. The pauses above come before each round. An address that does not answer takes at most
 * an equal part of the time that is left of retry_ms or open_ms, so that every address has its
 * turn. Outstanding requests go to the daemon that is found: daemons of the same version give the
 * same bits on every machine. A daemon with other lists is skipped. The client stays with the
 * daemon that it has found while that answers. */
void dipole_set_retry_ms(dipole_client *client, unsigned retry_ms);

/* The most addresses in a list. */
#define DIPOLE_ADDRESSES_MAX 16

/* The address of the daemon that the client is connected to, or tries next. The client owns it. */
const char *dipole_address(const dipole_client *client);

/* Closes the connection, ends a private daemon and frees the client. client may be NULL. */
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
  const char *about; /* Source of a model; unit of a quantity; unit, meaning and range of a
                        parameter; meaning of anything else. */
} dipole_choice;

typedef struct dipole_value {
  const char *name; /* ends with the unit, as in max_frame_bytes */
  uint64_t value;
} dipole_value;

/* What the daemon said about itself. */
typedef struct dipole_info {
  const char *address; /* of several, the one that answered first */
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

/* The client owns the info, which is valid until the client is closed. */
const dipole_info *dipole_get_info(const dipole_client *client);

/* The id of the choice of this kind with this name, or 0 if the daemon has none. The only choice
 * whose id is 0 is the status ok. */
unsigned dipole_id(const dipole_client *client, enum dipole_kind kind, const char *name);

/* ---- evaluating ---------------------------------------------------------------------------- */

/* These ids are permanent. Find the id of a model by its name, with dipole_id(). */
enum { DIPOLE_ANY_MODEL = 0 }; /* see dipole_query.model */
enum dipole_evaluator {
  DIPOLE_F64 = 1, /* computes in double precision */
  DIPOLE_F32 = 2, /* computes in single precision */
  DIPOLE_LUT = 3  /* looks up in a table, in single precision. The parameter tolerance is the error
                     that the table is built to: 1e-6 or more, by default 1e-4. */
};
enum dipole_moments { DIPOLE_EXACT = 1, DIPOLE_FIT = 2, DIPOLE_JENSEN = 3 };
enum dipole_quantity {
  DIPOLE_R = 1,      /* 1/mm^2 per unit of power that entered */
  DIPOLE_ALBEDO = 2, /* the integral of 2 pi r R(r), one value for each medium */
  DIPOLE_CDF = 4,    /* the energy within r over the albedo */
  DIPOLE_RADIUS = 8, /* mm: the radii that were used, one array for all media */
  DIPOLE_SLOPE = 16, /* dR/dr, 1/mm^3 */
  DIPOLE_LN_R = 32,  /* ln of R in 1/mm^2, also where R has underflowed. Its error is absolute: the
                        numerical error plus 8 epsilon |ln R|. */
  DIPOLE_PDF = 64,   /* the density of radii, 2 pi r R over the albedo, 1/mm */
  DIPOLE_RING = 128, /* 2 pi r R, 1/mm: the power that leaves per mm of radius. It is finite at
                        r = 0, where R of some models is infinite. */
  DIPOLE_S = 256     /* the BSSRDF, 1/(mm^2 sr), for the parameters cos_in and cos_out */
};
enum dipole_spacing { DIPOLE_LIST = 1, DIPOLE_LINEAR = 2, DIPOLE_LOGARITHMIC = 3 };

typedef struct dipole_medium {
  double sigma_a_per_mm; /* absorption coefficient, 0 to 1e15 */
  double sigma_s_per_mm; /* scattering coefficient, 0 to 1e15 */
  double g;              /* mean cosine of the phase function, between -1 and 1 */
  double eta;            /* index of refraction inside over that outside, 0.001 to 1000 */
} dipole_medium;

/* An optional number of a query. The choices of kind DIPOLE_PARAMETER tell which there are, with
 * their units and ranges. A model refuses a parameter that it does not take. */
typedef struct dipole_parameter {
  unsigned id;  /* for example dipole_id(client, DIPOLE_PARAMETER, "cos_in") */
  double value; /* not NaN */
} dipole_parameter;

typedef struct dipole_query {
  /* dipole_id(client, DIPOLE_MODEL, name). Or DIPOLE_ANY_MODEL: the cheapest model and evaluator
   * that are measured to be within the parameter `tolerance` of radiative transport, for all media
   * and from the smallest to the largest radius. The result names those that were taken. */
  unsigned model;
  unsigned evaluator;         /* enum dipole_evaluator: also the type of radii and values. With
                         DIPOLE_ANY_MODEL it is only the type: F32 and LUT then mean the same. */
  unsigned moments;           /* enum dipole_moments */
  unsigned wanted;            /* sum of enum dipole_quantity */
  const dipole_medium *media; /* [medium_count], one for each channel */
  uint32_t medium_count;
  unsigned spacing;  /* enum dipole_spacing */
  const void *radii; /* for LIST: [radius_count] of double (F64) or float, mm, 0 to infinity */
  uint64_t radius_count;
  double radius_start_mm;             /* for LINEAR and LOGARITHMIC: the first radius */
  double radius_stop_mm;              /* and the last one */
  const dipole_parameter *parameters; /* [parameter_count], each id at most once; NULL for none */
  size_t parameter_count;
  /* The daemon refuses with status `deadline` what it cannot answer within so many ms after the
   * query has arrived. 0 is no limit. */
  unsigned deadline_ms;
  /* Memory of the caller for the answer; NULL: the result holds its arrays. into_values is
   * [medium_count][wanted quantities with an array][radius_count] of double or float, with the
   * quantities in the order of enum dipole_quantity. into_radii is [radius_count], needed if
   * DIPOLE_RADIUS is wanted. Do not touch this memory until the query is collected, refused or
   * given up, or the client is closed. It holds values only if the call that hands out the result
   * succeeds. dipole_eval_parts() does not use it. */
  void *into_values;
  void *into_radii;
} dipole_query;

/* The answer for one medium. An array is NULL if its quantity was not wanted, or if the evaluator
 * has the other type: *_f64 belong to DIPOLE_F64, *_f32 to the others. */
typedef struct dipole_channel {
  double albedo; /* NaN if not wanted */
  /* A value at radius r is off from the model's formula by at most
   * numerical_error + numerical_error_per_mm * r, relative. */
  double numerical_error;
  double numerical_error_per_mm;
  double model_error;    /* Error of the model against radiative transport, relative, for the radii
                            that were asked for; NaN if it was not measured. */
  const double *R_f64;   /* [radius_count], 1/mm^2 */
  const double *cdf_f64; /* [radius_count] */
  const float *R_f32;
  const float *cdf_f32;
} dipole_channel;

typedef struct dipole_result {
  unsigned model, evaluator, moments, wanted; /* those that the daemon took */
  unsigned notes; /* sum of the ids of the choices of kind DIPOLE_NOTE that hold for a channel */
  uint64_t radius_count;
  const double *radius_f64; /* [radius_count], mm; NULL unless DIPOLE_RADIUS was wanted */
  const float *radius_f32;
  uint32_t channel_count;
  const dipole_channel *channels; /* [channel_count], in the order of the query's media */
} dipole_result;

/* Evaluates and waits for the answer, which may have any size that fits into memory. The caller
 * frees *result with dipole_result_free(). Answers to submitted queries that arrive meanwhile are
 * kept. */
bool dipole_eval(dipole_client *client, const dipole_query *query, dipole_result **result,
                 dipole_error *error);

/* Evaluates like dipole_eval(), but hands each part of the answer to part() as soon as it arrives
 * and keeps nothing, so that an answer may be larger than memory. The daemon chooses how many radii
 * come at a time: an answer that fits into a frame (limit max_frame_bytes) is one part; the parts
 * of a larger one have up to max_part_bytes.
 *
 * *part is a result for the part->radius_count radii from position radius_first on of those asked
 * for. Everything but its arrays is the same in all parts. It is valid until part() returns, which
 * must neither free it nor use the client. The daemon waits while part() works.
 *
 * Returns true when part() has got all parts. Returns false if an error ended the answer; the parts
 * before it are right. When part() returns false, the call fails with kind STOPPED. The client goes
 * on working, but its next calls wait until the rest has come and throw it away: if much is left,
 * it is better to close the client. */
bool dipole_eval_parts(dipole_client *client, const dipole_query *query,
                       bool (*part)(void *context, const dipole_result *part,
                                    uint64_t radius_first),
                       void *context, dipole_error *error);

void dipole_result_free(dipole_result *result); /* result may be NULL */

/* The array of a quantity: [radius_count], owned by the result. NULL if the quantity was not wanted
 * or has no array for each channel, if the evaluator has the other type, or if there is no such
 * channel. Only the albedo has no array, and the radius has none but in a result of
 * dipole_sample(). */
const double *dipole_values_f64(const dipole_result *result, uint32_t channel, unsigned quantity);
const float *dipole_values_f32(const dipole_result *result, uint32_t channel, unsigned quantity);

/* ---- many at once -------------------------------------------------------------------------- */

/* Queries can be sent without waiting for the answers to earlier ones. Their answers are collected
 * in any order:
 *
 *   for (i = 0; i < n; i++) { dipole_submit(client, &queries[i], &ids[i], &error) ... }
 *   for (i = 0; i < n; i++) { dipole_collect(client, &id, &result, &error) ... }
 *
 * Every call that waits receives what arrives, also dipole_submit() when the daemon takes no more.
 * So a program that submits without collecting cannot make both sides wait for each other, but the
 * answers take memory: in_flight_max limits how many. The daemon waits while a program does not
 * call the library. */

/* Submits a query and sets *id, which is never 0. The query and its radii are copied; into_values
 * and into_radii are not. Fails with kind FULL if in_flight_max queries are outstanding. After kind
 * TIMEOUT the query is not submitted. */
bool dipole_submit(dipole_client *client, const dipole_query *query, uint64_t *id,
                   dipole_error *error);

/* Sends the queries that are held back. Until a call waits, the library holds back up to a quarter
 * of the outstanding queries and up to 16 KiB. A program that now does something else for a while
 * calls this first. */
void dipole_flush(dipole_client *client);

/* Waits for the next answer to an outstanding query and sets *id to that query's. The caller frees
 * *result with dipole_result_free(). Kind REFUSED: the query *id was refused, the others go on.
 * Kind TIMEOUT: no answer came in time, and all queries go on. Kind ARGUMENT: nothing is
 * outstanding. */
bool dipole_collect(dipole_client *client, uint64_t *id, dipole_result **result,
                    dipole_error *error);

/* The same for one outstanding query. Kind ARGUMENT: no outstanding query has this id. */
bool dipole_collect_id(dipole_client *client, uint64_t id, dipole_result **result,
                       dipole_error *error);

/* The number of queries that have been submitted and not been collected. */
size_t dipole_outstanding(const dipole_client *client);

/* ---- the trade between speed and accuracy -------------------------------------------------- */

/* A model and evaluator that could answer a query. */
typedef struct dipole_offer {
  unsigned model;     /* id of the daemon's list */
  unsigned evaluator; /* enum dipole_evaluator */
  bool meets;         /* It is known to keep the parameter tolerance. */
  double error;       /* relative, against radiative transport, for the query's radii, all of its
                         media and all that is wanted; INFINITY if it is not known */
  double numerical_error; /* the evaluator's part of error; of a table, the error it is built to */
  double cost_ns;         /* of one value, as measured once on one machine */
  double prepare_ns;      /* of one medium, measured likewise */
} dipole_offer;

/* Lists what could answer a query whose model is DIPOLE_ANY_MODEL, cheapest first. The caller frees
 * *offers, an array of *count, with free(). Of listed radii only the range matters. *taken: the
 * position of the offer that dipole_eval() would take, or *count if there is none; taken may be
 * NULL. */
bool dipole_offers(dipole_client *client, const dipole_query *query, dipole_offer **offers,
                   size_t *count, size_t *taken, dipole_error *error);

/* ---- drawing radii ------------------------------------------------------------------------- */

/* How the numbers u of a query are given, for i from 0 to sample_count - 1. */
enum dipole_draw {
  DIPOLE_DRAW_LIST = 1,       /* by numbers */
  DIPOLE_DRAW_REGULAR = 2,    /* (i + 1/2) / sample_count */
  DIPOLE_DRAW_STRATIFIED = 3, /* (i + random number i of the seed) / sample_count */
  DIPOLE_DRAW_RANDOM = 4      /* random number sample_first + i of the seed */
};

typedef struct dipole_sample_query {
  unsigned model;     /* dipole_id(client, DIPOLE_MODEL, name) of a model that covers all radii */
  unsigned evaluator; /* enum dipole_evaluator: also the type of numbers, radii and values */
  unsigned moments;   /* enum dipole_moments */
  unsigned wanted;    /* Sum of enum dipole_quantity. DIPOLE_RADIUS is the drawn radii; all other
                      quantities are evaluated at them. */
  const dipole_medium *media; /* [medium_count], one for each channel */
  uint32_t medium_count;
  unsigned draw;       /* enum dipole_draw. All channels get the same numbers. */
  const void *numbers; /* for LIST: [sample_count] of double (F64) or float, 0 to 1 included */
  uint64_t sample_count;
  uint64_t sample_first; /* for RANDOM: 0 to 2^52 */
  uint64_t seed;         /* for RANDOM and STRATIFIED: a seed gives the same bits everywhere */
  const dipole_parameter *parameters; /* [parameter_count], as of an eval */
  size_t parameter_count;
  unsigned deadline_ms; /* as of an eval */
} dipole_sample_query;

/* Draws radii in proportion to r R(r) and waits for the answer: the radius for a number u is the
 * one with cdf(r) = u, which is 0 mm for 0 and INFINITY for 1. DIPOLE_PDF is in 1/mm; pdf / (2 pi
 * r) is the density of points per mm^2. In the result, radius_count is sample_count, and
 * dipole_values_f64() or dipole_values_f32() give the radii of a channel for DIPOLE_RADIUS;
 * radius_f64 and radius_f32 are NULL. The caller frees *result with dipole_result_free(). */
bool dipole_sample(dipole_client *client, const dipole_sample_query *query, dipole_result **result,
                   dipole_error *error);

/* Computes the numbers begin, ..., begin + n - 1 of a query that has them by a rule, without a
 * daemon and with the daemon's bits. u: [n] of double (F64) or float. */
bool dipole_sample_numbers(const dipole_sample_query *query, uint64_t begin, size_t n, void *u,
                           dipole_error *error);

/* ---- from albedos to coefficients ---------------------------------------------------------- */

/* Which length of a medium is known. sigma_t' = sigma_a + sigma_s (1 - g). */
enum dipole_length {
  DIPOLE_MEAN_FREE_PATH = 1, /* 1 / sigma_t' */
  DIPOLE_DIFFUSE_MEAN_FREE_PATH =
      2,                            /* 1 / (sigma_t' sqrt(3 a / (1 + a))), a = sigma_a / sigma_t' */
  DIPOLE_CLASSICAL_DIFFUSE_PATH = 3 /* 1 / sqrt(3 sigma_a sigma_t') */
};

typedef struct dipole_invert_query {
  unsigned model;   /* the model under which the albedo is known; it must depend on the medium */
  unsigned moments; /* enum dipole_moments */
  unsigned given;   /* enum dipole_length */
  double g, eta;    /* of all media */
  const double
      *albedos; /* [medium_count], 0 to 1: integral of 2 pi r R(r), per power that entered */
  const double *lengths_mm; /* [medium_count], 1e-14 to 1e14 */
  uint64_t
      medium_count;     /* At least 1, and as many as fit into a frame: limit max_frame_bytes. For a
                            model that takes seconds to prepare, such as transport, at most the
                            limit max_media. */
  unsigned deadline_ms; /* as of an eval */
} dipole_invert_query;

/* The arrays are [medium_count], in the order of the query, with NaN where there is no such
 * medium. */
typedef struct dipole_inversion {
  uint64_t medium_count;
  uint64_t missing_count; /* how many media are NaN */
  const double *sigma_a_per_mm;
  const double *sigma_s_per_mm;
  const double
      *albedos;        /* of these media: within 1e-12 of what was wanted, relative, or a few units
                            of the last place of what the model resolves */
  double albedo_least; /* what the model can reach with this g and eta: an albedo that is not */
  double
      albedo_most; /* between these has no medium, nor has one without absorption a diffuse path */
} dipole_inversion;

/* Finds the media that have the given albedos and lengths, and waits for the answer. The caller
 * frees *inversion with dipole_inversion_free(). */
bool dipole_invert(dipole_client *client, const dipole_invert_query *query,
                   dipole_inversion **inversion, dipole_error *error);

void dipole_inversion_free(dipole_inversion *inversion); /* inversion may be NULL */

/* ---- tables -------------------------------------------------------------------------------- */

/* The table that the evaluator DIPOLE_LUT uses for one medium. It is evaluated here, without a
 * daemon and with the same bits. A table never changes: any number of threads may evaluate it at
 * once. */
typedef struct dipole_table dipole_table;

typedef struct dipole_table_query {
  unsigned model;   /* dipole_id(client, DIPOLE_MODEL, name) */
  unsigned moments; /* enum dipole_moments */
  dipole_medium medium;
  const dipole_parameter *parameters; /* [parameter_count], as of an eval: tolerance, ... */
  size_t parameter_count;
  unsigned deadline_ms; /* as of an eval */
} dipole_table_query;

/* What holds for all values of a table. The table owns it. */
typedef struct dipole_table_info {
  unsigned layout; /* of the words: see proto/PROTOCOL.md, "table" */
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
  double pieces_from_mm; /* The table has pieces between these two radii; outside of them it uses */
  double pieces_to_mm;   /* known asymptotes. */
  double radius_least_mm; /* the range of radii that the model covers, both ends included */
  double radius_most_mm;
  const uint32_t *words; /* [word_count]: the bits of single precision numbers and of entries */
  size_t word_count;
} dipole_table_info;

/* Fetches a table from a daemon. The caller frees *table with dipole_table_free(). */
bool dipole_table_fetch(dipole_client *client, const dipole_table_query *query,
                        dipole_table **table, dipole_error *error);

/* Makes a table of bytes that dipole_table_bytes() gave, at any alignment. The bytes are copied. It
 * ignores what follows the table's own bytes, so a file may hold several tables, one behind the
 * other. Fails with kind TABLE if the bytes are damaged or have another layout; whatever they say,
 * nothing outside of the table is ever read. The caller frees *table with dipole_table_free(). */
bool dipole_table_load(const void *bytes, size_t count, dipole_table **table, dipole_error *error);

/* The table as *count bytes, for saving: the whole frame of the daemon's reply, which is the same
 * on every machine. The table owns them. */
const void *dipole_table_bytes(const dipole_table *table, size_t *count);

const dipole_table_info *dipole_table_get_info(const dipole_table *table);

/* Evaluates DIPOLE_R, DIPOLE_CDF, DIPOLE_PDF, DIPOLE_RING, or DIPOLE_S for the parameters cos_in
 * and cos_out of the query. r: [n] in mm, from 0 to infinity. out: [n] in the quantity's unit. The
 * arrays must not overlap. Returns false and leaves out as it was if the table does not hold that
 * quantity, or if a radius is NaN, negative or not covered by the model. */
bool dipole_table_values(const dipole_table *table, enum dipole_quantity quantity, size_t n,
                         const float *r, float *out);

/* Computes the radii r[n] in mm with cdf(r) = u, for drawing them at random. u: [n] from 0 to 1,
 * both included; 1 gives INFINITY. All radii are 0 if nothing scatters. The arrays must not
 * overlap. Returns false and leaves r as it was if a u is out of range. */
bool dipole_table_radii(const dipole_table *table, size_t n, const float *u, float *r);

void dipole_table_free(dipole_table *table); /* table may be NULL */

/* Computes the radii r[count], mm, of a LINEAR or LOGARITHMIC grid as a daemon does in single
 * precision, for evaluating a table at the radii of a query with this grid. */
bool dipole_grid_radii(enum dipole_spacing spacing, double start_mm, double stop_mm, uint64_t count,
                       float *r, dipole_error *error);

/* What this library knows without a daemon: its lists, and the instruction set with which it
 * evaluates tables. address is "". The caller frees *info, which is one block, with free(). */
bool dipole_local_info(dipole_info **info, dipole_error *error);

/* ---- Monte Carlo --------------------------------------------------------------------------- */

/* A job for the daemon: it walks photons through a medium until enough have been walked or the
 * errors are small enough. The same query gives the same bits unless it is ended early. */
typedef struct dipole_mc_query {
  dipole_medium medium;
  const double *albedos;  /* [albedo_count] of single scattering, 0 to 1, in place of the medium's
                             own. One walk serves all of them. */
  unsigned albedo_count;  /* 0 to 16; 0 is the medium's own albedo */
  double thickness_mm;    /* of a slab; INFINITY is a half space */
  unsigned spacing;       /* of the rings' edges: DIPOLE_LINEAR or DIPOLE_LOGARITHMIC */
  uint32_t ring_count;    /* 1 to 4096 */
  double radius_start_mm; /* inner edge of the first ring */
  double radius_stop_mm;  /* outer edge of the last */
  uint64_t seed;
  uint64_t photons;   /* at least 1, at most the daemon's limit max_mc_photons */
  double error_total; /* relative standard error of R that is small enough; 0: do not stop early */
  double error_rings; /* likewise of each ring with light. If both are given, both must hold. */
} dipole_mc_query;

enum dipole_mc_side { DIPOLE_MC_REFLECTED, DIPOLE_MC_TRANSMITTED, DIPOLE_MC_SIDES };

typedef struct dipole_mc_progress {
  uint64_t photons;          /* walked so far */
  uint64_t photons_expected; /* how many it will take in all, as far as is known */
  double error_total;        /* relative standard error of R, the largest of all albedos */
  double error_rings;        /* likewise of the worst ring with light; INFINITY: not known yet */
  double worst_from_mm;      /* the edges of that ring; both 0 if there is none */
  double worst_to_mm;
  unsigned worst_side;   /* enum dipole_mc_side: where that ring lies */
  unsigned worst_albedo; /* the albedo's position for which it is the worst */
} dipole_mc_progress;

/* A fraction of the power that entered the medium, and its standard error. */
typedef struct dipole_mc_value {
  double value;
  double error;
} dipole_mc_value;

/* Where the power went, for one albedo. The arrays are by side. */
typedef struct dipole_mc_energy {
  double albedo;
  dipole_mc_value R; /* leaves where light enters: unscattered, under, rings and over together */
  dipole_mc_value T; /* leaves on the other side of a slab, likewise */
  dipole_mc_value absorbed;
  dipole_mc_value unfinished; /* was still inside when its walk was given up */
  dipole_mc_value roulette;   /* what roulette has added minus what it has removed; about 0 */
  double unscattered[DIPOLE_MC_SIDES];    /* leaves at r = 0, in no ring; exact */
  dipole_mc_value under[DIPOLE_MC_SIDES]; /* leaves within the inner edge of the first ring */
  dipole_mc_value over[DIPOLE_MC_SIDES];  /* leaves beyond the outer edge of the last ring */
  double imbalance; /* R + T + absorbed + unfinished - roulette - 1, which is 0 up to rounding */
} dipole_mc_energy;

enum dipole_mc_end {
  DIPOLE_MC_PHOTONS = 1, /* All photons have been walked. */
  DIPOLE_MC_ERRORS,      /* The errors are small enough. */
  DIPOLE_MC_CANCELLED, /* The caller cancelled the job: the table is of what was walked by then. */
  DIPOLE_MC_STOPPED,   /* The daemon stopped: likewise. */
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

/* Starts a job and waits for its table. progress(), unless NULL, is called a few times a second; it
 * must not use the client. When it returns false the job is cancelled and ends with the table so
 * far. The caller frees *result with dipole_mc_result_free(). */
bool dipole_mc(dipole_client *client, const dipole_mc_query *query,
               bool (*progress)(void *context, const dipole_mc_progress *now), void *context,
               dipole_mc_result **result, dipole_error *error);

void dipole_mc_result_free(dipole_mc_result *result); /* result may be NULL */

/* These arrays are [ring_count] and owned by the result; NULL if there is no such albedo or side.
 * They hold the means over the rings of the power that leaves there, in 1/mm^2 per unit of power
 * that entered; the standard errors of these means; and the numbers of photons that left there,
 * whatever their weight. */
const double *dipole_mc_values(const dipole_mc_result *result, uint32_t albedo,
                               enum dipole_mc_side side);
const double *dipole_mc_errors(const dipole_mc_result *result, uint32_t albedo,
                               enum dipole_mc_side side);
const uint64_t *dipole_mc_photons(const dipole_mc_result *result, enum dipole_mc_side side);

/* ---- the rest ------------------------------------------------------------------------------ */

/* A measured medium. Its three channels are red, green and blue. */
typedef struct dipole_measured_medium {
  char name[17];
  dipole_medium channel[3];
} dipole_measured_medium;

/* The daemon's measured media. The caller frees *media, an array of *count, with free(). */
bool dipole_media(dipole_client *client, dipole_measured_medium **media, size_t *count,
                  dipole_error *error);

/* The daemon's statistics. The caller frees *values, an array of *count, with free(). The names are
 * in the same block. */
bool dipole_statistics(dipole_client *client, dipole_value **values, size_t *count,
                       dipole_error *error);

/* Makes a round trip that does nothing else. */
bool dipole_ping(dipole_client *client, dipole_error *error);

#ifdef __cplusplus
}
#endif

#endif
