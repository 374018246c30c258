/* libdipole: requests subsurface-scattering profiles R(r) from a dipoled.
 *
 *   dipole_client *client;
 *   dipole_error error;
 *   if (!dipole_open(NULL, &client, &error)) { puts(error.text); ... }
 *   dipole_medium skin = {.sigma_a_per_mm = 0.032, .sigma_s_per_mm = 0.74, .g = 0, .eta = 1.3};
 *   float r[2] = {0.5f, 1.0f};
 *   dipole_query query;
 *   dipole_query_init(&query);
 *   query.media = &skin, query.medium_count = 1;
 *   query.radii = r, query.radius_count = 2;
 *   dipole_result *result;
 *   if (!dipole_eval(client, &query, &result, &error)) { ... }
 *   printf("%g 1/mm^2\n", (double)result->channels[0].R_f32[1]);
 *   dipole_result_free(result);
 *   dipole_close(client);
 *
 * Units: lengths in mm, coefficients in 1/mm, R in 1/mm^2 per unit of power that entered the
 * medium.
 *
 * A client is one connection and belongs to one thread at a time. Use one client for each thread.
 * After fork(), only the process that opened a client can use it: in the other one its calls fail
 * with kind CONNECTION, and dipole_close() frees the copy and disturbs neither the connection nor a
 * private daemon. A client that a call left before its end, by an exception of a caller's function
 * or by longjmp(), can only be closed: its calls fail with kind CONNECTION. The library has no global
 * state and never ends the program. A function that returns bool returns false on failure and then
 * fills *error; error may be NULL.
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

  /* After an error of these kinds, the client continues to work. */
  DIPOLE_ERROR_ARGUMENT = 6, /* The call's arguments do not fit together. */
  DIPOLE_ERROR_REFUSED,      /* The daemon refused the request. */
  DIPOLE_ERROR_TABLE,        /* The bytes are damaged, or a table of an unknown layout. */
  DIPOLE_ERROR_STOPPED,      /* The caller's function returned false to end the reply. */
  DIPOLE_ERROR_TIMEOUT,      /* The call took longer than call_timeout_ms. */
  DIPOLE_ERROR_FULL,         /* in_flight_max queries are outstanding. */

  /* After an error of these kinds, there is no client, or the client can only be closed. */
  DIPOLE_ERROR_ADDRESS = 1, /* The text of the address is malformed. */
  DIPOLE_ERROR_CONNECT,     /* No daemon replies at the address. */
  DIPOLE_ERROR_CONNECTION,  /* The connection was lost or timed out: see dipole_set_retry_ms(). */
  DIPOLE_ERROR_PROTOCOL,    /* The peer does not follow the protocol. */
  DIPOLE_ERROR_MEMORY,      /* Out of memory. The client works on unless it was receiving. */
};

typedef struct dipole_error {
  enum dipole_error_kind kind;
  /* Kind REFUSED sets status, index, field, allowed and retry_after_ms. */
  unsigned status;         /* the daemon's status code */
  uint64_t index;          /* position of the value at fault in its array */
  char field[33];          /* name of the field at fault, or "" */
  char allowed[81];        /* what is allowed in that field, or "" */
  uint32_t retry_after_ms; /* how long to wait if the daemon is busy; else 0 */
  char text[256];          /* a message for people, which includes all other fields */
} dipole_error;

/* ---- connecting ---------------------------------------------------------------------------- */

/* Connects, agrees on a protocol version and reads the daemon's lists. address is one of
 *   unix:PATH          a Unix socket
 *   tcp:HOST:PORT      TCP ([::1]:PORT for IPv6)
 *   tls:HOST:PORT      TCP with TLS 1.2 or 1.3: see ca, certificate and key of dipole_options
 *   private:           starts a dipoled that serves only this client and ends with it: the one
 *                      beside the running program, else the one in $PATH. It logs only errors.
 *   private:PROGRAM    starts this program as the private daemon
 *   NULL               $DIPOLED if that is set, else private:
 * Several addresses but private: may be given, separated by commas without blanks: see "Several
 * daemons" below. A comma that no unix:, tcp: or tls: follows is part of a path. The caller closes
 * *client with dipole_close(). While no daemon replies, the call retries for
 * DIPOLE_RETRY_MS. On failure *client is NULL; kind REFUSED then means that the daemon did not take
 * the connection, for example because it has too many. */
bool dipole_open(const char *address, dipole_client **client, dipole_error *error);

/* The values that dipole_options_init() sets. */
#define DIPOLE_CONNECT_TIMEOUT_MS 10000
#define DIPOLE_TIMEOUT_MS 30000
#define DIPOLE_RETRY_MS 5000
#define DIPOLE_IN_FLIGHT_MAX 4096

/* Options of a client. Set them all with dipole_options_init() before you change any. */
typedef struct dipole_options {
  /* The longest time from the start of connecting to an address until the daemon's reply to hello;
   * 0 is no limit. For private: addresses, timeout_ms is the limit instead. The look-up of a host
   * name does not count: the system limits it. Default: 10000. */
  unsigned connect_timeout_ms;
  /* The client gives up the connection when a call has waited this long and no byte was received or
   * sent; 0 is no limit. Default: 30000. */
  unsigned timeout_ms;
  /* The longest time for any call except dipole_mc(), reconnecting included; 0 is no limit. A call
   * that takes longer fails with kind TIMEOUT, and the client continues to work. Submitted queries
   * stay outstanding; the reply to any other request is thrown away when it comes. The daemon is
   * not given this limit, only the deadline_ms of a query. Default: 0. */
  unsigned call_timeout_ms;
  /* For how long the client retries, here and in later calls: see dipole_set_retry_ms().
   * dipole_open_with() tries all addresses in turn until one replies, and fails when no daemon has
   * replied for retry_ms; 0, as always for private:, tries each address once. Default: 5000. */
  unsigned retry_ms;
  /* How many outstanding queries make dipole_submit() fail as FULL; 0: no limit. Default: 4096. */
  unsigned in_flight_max;
  /* Which of several addresses is tried first. false: the first one in the list; true: a random
   * one, so that many clients spread over the daemons. Default: false. */
  bool spread;
  /* For tls: addresses, names of files in PEM format, which the client reads whenever it connects.
   * ca: the certificates that sign the daemon's; NULL: $DIPOLED_CA if that is set, else those of the
   * system. certificate, key: the client's own, for daemons that request one; NULL:
   * $DIPOLED_CERTIFICATE and $DIPOLED_KEY. A missing key is in the certificate's file. The daemon's
   * certificate has to be good for the host in the address. If a certificate is at fault, opening
   * fails at once with kind CONNECT or CONNECTION. Default: NULL. */
  const char *ca;
  const char *certificate;
  const char *key;
  unsigned reserved[2]; /* must be 0 */
} dipole_options;

void dipole_options_init(dipole_options *options);

/* Opens a client like dipole_open(), with options. NULL means the default options. */
bool dipole_open_with(const char *address, const dipole_options *options, dipole_client **client,
                      dipole_error *error);

/* These functions change an option of dipole_options for all later calls. */
void dipole_set_timeout_ms(dipole_client *client, unsigned timeout_ms);
void dipole_set_call_timeout_ms(dipole_client *client, unsigned call_timeout_ms);

/* The most bytes of requests without a reply that a client keeps to send them again. */
#define DIPOLE_RETRY_KEPT_BYTES ((size_t)64 << 20)

/* Sets for how long the client retries a request that fails for a temporary reason. It holds for
 * all later requests. 0, the default of private: addresses, means that the client never retries.
 *
 * Temporary reasons are a lost connection, a daemon that ends the connection (SHUTTING_DOWN,
 * TIMEOUT), and the replies BUSY and SHUTTING_DOWN. The client connects again if it has to, and
 * sends the requests again, with the same ids and the rest of their deadlines, and not before the
 * daemon's retry_after_ms. The pauses between two attempts grow from 10 ms to 1 s: each is twice as
 * long as the one before, shortened at random by up to a half, and at most half of the time that is
 * left. A request that has no reply
 * retry_ms after its first failure fails with the kind of that failure: CONNECTION or REFUSED.
 *
 * Every daemon gives the same reply to a request, so a repeated request never yields a wrong reply
 * or two replies. A Monte Carlo job whose daemon is lost or stops begins anew with the next daemon,
 * without the photons walked so far. A report of progress ends its failure: if the job fails again,
 * the client retries for retry_ms again.
 *
 * When the connection is lost, all outstanding requests fail if the client cannot repeat one of
 * them: a job that the caller has cancelled; a request of dipole_eval_parts() that has handed on a
 * part; or one for which DIPOLE_RETRY_KEPT_BYTES had no room. They also fail if the new daemon has other lists than
 * the first one, which dipole_get_info() continues to describe. If the list has a single address,
 * requests fail when its daemon stays connected and silent for timeout_ms.
 *
 * Several daemons. The client connects to the first address that replies. When that connection is
 * lost, or its daemon is silent for timeout_ms, the client tries the next address in the list, and
 * so on in a circle. It pauses before each round. The rest of retry_ms is shared equally among the
 * addresses that are still to be tried, so that a daemon that hangs leaves time for the others.
 * Outstanding requests go to the new daemon: daemons of the same version give the same bits on
 * every machine.
 * The client skips a daemon with other lists. It stays with a daemon as long as it replies. */
void dipole_set_retry_ms(dipole_client *client, unsigned retry_ms);

/* The largest number of addresses in a list. */
#define DIPOLE_ADDRESSES_MAX 16

/* Returns the address that the client is connected to or tries next. The client owns the text. */
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
  DIPOLE_PHASE,
  DIPOLE_SCALE,
  DIPOLE_AXIS,
  DIPOLE_FIT_STATUS,
  DIPOLE_LIGHT,
  DIPOLE_VALUE,
  DIPOLE_COEFFICIENT,
  DIPOLE_UNKNOWN,
  DIPOLE_PROPERTY,
  DIPOLE_HAEMOGLOBIN,
  DIPOLE_TISSUE,
};

typedef struct dipole_choice {
  enum dipole_kind kind;
  unsigned id;
  const char *name;
  const char *about; /* of a model: its source; of a quantity: its unit; of a parameter: its unit,
                        meaning and range; of all others: the meaning */
} dipole_choice;

typedef struct dipole_value {
  const char *name; /* ends with the unit, as in max_frame_bytes */
  uint64_t value;
} dipole_value;

/* A daemon's description of itself. */
typedef struct dipole_info {
  const char *address; /* the address at which this daemon replied */
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

/* Returns what the first daemon of this client said about itself. The client owns the info, which
 * is valid until the client is closed. */
const dipole_info *dipole_get_info(const dipole_client *client);

/* Finds the id of the choice of this kind and name. Returns 0 if the daemon has no such choice; the
 * only choice that has the id 0 is the status ok. Every call that takes the id of a model or of a
 * parameter fails with kind ARGUMENT if that id is 0. */
unsigned dipole_id(const dipole_client *client, enum dipole_kind kind, const char *name);

/* ---- evaluating ---------------------------------------------------------------------------- */

/* The ids of evaluators, moments, quantities and spacings are permanent. Find the id of a model by
 * its name, with dipole_id(). */
enum { DIPOLE_ANY_MODEL = 65536 }; /* see dipole_query.model; no model has this id */
enum dipole_evaluator {
  DIPOLE_F64 = 1, /* computes in double precision */
  DIPOLE_F32 = 2, /* computes in single precision */
  DIPOLE_LUT = 3  /* looks values up in a table, in single precision. The parameter tolerance is
                     the error that the table is built to: at least 1e-6, by default 1e-4. A value
                     above 0.1 counts as 0.1. */
};
enum dipole_moments { DIPOLE_EXACT = 1, DIPOLE_FIT = 2, DIPOLE_JENSEN = 3 };
/* Errors are relative, but those of ln R, its derivatives, paths, modulated light and the balance are
 * absolute: of ln R the numerical error plus 8 epsilon |ln R|, of R_f the numerical error times the
 * albedo. With quantities that end with _f the radii are spatial frequencies of striped light in 1/mm.
 *
 * Derivatives of ln R, by ln sigma_a and ln sigma_s (or sigma_s') at fixed r, g and eta, are 0 where R
 * is 0. Dipoles, Burley's models, single scattering, the sums of dipoles and it, and transport have them
 * and, if sigma_a is above 0, paths; all of them but Burley's models have modulated light. Of layers they
 * are those of the parameter derivative_layer. The time is by the parameter index, else eta. The lag is
 * not reduced to a circle; the modulation is relative to that of the light that enters.
 *
 * The albedo, model_error and the balance are in dipole_channel. Finding model_error takes a millisecond
 * for each new medium, and microseconds after that, which a query that leaves it out does not pay.
 * model_errors are of the other quantities that are wanted (of R, if there is none); for a medium that
 * transport solves they take seconds, and model_error is then known as well. */
enum dipole_quantity {
  /* quantities: begin */
  /* R, 1/mm^2: per unit of power that entered */
  DIPOLE_R = 1,
  /* albedo, 1: integral of 2_pi_r_R */
  DIPOLE_ALBEDO = 2,
  /* cdf, 1: share of the albedo within r */
  DIPOLE_CDF = 4,
  /* r, mm: for all channels */
  DIPOLE_RADIUS = 8,
  /* dR_dr, 1/mm^3 */
  DIPOLE_SLOPE = 16,
  /* ln_R, ln(1/mm^2): finite where R underflows */
  DIPOLE_LN_R = 32,
  /* pdf, 1/mm: derivative of the cdf */
  DIPOLE_PDF = 64,
  /* 2_pi_r_R, 1/mm: finite at 0 */
  DIPOLE_RING = 128,
  /* S, 1/(mm^2 sr): BSSRDF at cos_in, cos_out */
  DIPOLE_S = 256,
  /* R_f, 1: integral of 2_pi_r_R J0(2 pi f r) */
  DIPOLE_TRANSFER = 512,
  /* dlnR_dln_sigma_a, 1: for fits */
  DIPOLE_BY_SIGMA_A = 1024,
  /* dlnR_dln_sigma_s, 1: for fits */
  DIPOLE_BY_SIGMA_S = 2048,
  /* model_error, 1: the largest */
  DIPOLE_MODEL_ERROR = 4096,
  /* model_errors, 1: of each radius */
  DIPOLE_MODEL_ERRORS = 8192,
  /* T, 1/mm^2: as R, below the last layer: transport; 0 below half spaces */
  DIPOLE_T = 16384,
  /* path, mm: mean length in the medium */
  DIPOLE_PATH = 32768,
  /* dpf, 1: path/r */
  DIPOLE_DPF = 65536,
  /* time, ps: on paths, by the index */
  DIPOLE_TIME = 131072,
  /* phase, degrees: lag of modulated light */
  DIPOLE_LAG = 262144,
  /* modulation, 1: its amplitude */
  DIPOLE_MODULATION = 524288,
  /* balance, 1: where power goes */
  DIPOLE_BALANCE = 1048576,
  /* phase_f, degrees: of R_f */
  DIPOLE_LAG_F = 2097152,
  /* modulation_f, 1: of R_f */
  DIPOLE_MODULATION_F = 4194304,
  /* quantities: end */
};
enum dipole_spacing { DIPOLE_LIST = 1, DIPOLE_LINEAR = 2, DIPOLE_LOGARITHMIC = 3 };

/* A medium of one layer, or one layer of a medium, whose layers lie in an array from the top down. */
typedef struct dipole_medium {
  double sigma_a_per_mm; /* absorption coefficient, 0 to 1e15 */
  double sigma_s_per_mm; /* scattering coefficient, 0 to 1e15 */
  double g;              /* mean cosine of the phase function, between -1 and 1 */
  double eta;            /* index of refraction inside over that outside, 0.001 to 1000 */
  double thickness_mm;   /* 0: a half space, which only the last layer may be; or 1e-15 to 1e30 */
} dipole_medium;

/* An optional number of a query. The choices of kind DIPOLE_PARAMETER list all parameters, with
 * their units and ranges. The daemon refuses a parameter that the model does not have. */
typedef struct dipole_parameter {
  unsigned id;  /* for example dipole_id(client, DIPOLE_PARAMETER, "cos_in") */
  double value; /* not NaN */
} dipole_parameter;

typedef struct dipole_query {
  /* dipole_id(client, DIPOLE_MODEL, name). With DIPOLE_ANY_MODEL the daemon takes transport in the
   * cheapest evaluator that is within the parameter `tolerance` of radiative transport, for all media
   * and from the smallest to the largest radius. The time to prepare a medium counts, so that few
   * radii may get another evaluator than many. The result names both. */
  unsigned model;
  unsigned evaluator; /* enum dipole_evaluator. It sets the type of radii and values, too. With
                         DIPOLE_ANY_MODEL it sets only the type: F32 and LUT then mean the same. */
  unsigned moments;   /* enum dipole_moments */
  unsigned wanted;    /* sum of enum dipole_quantity */
  const dipole_medium *media; /* [medium_count][layer_count], one medium for each channel */
  uint32_t layer_count;       /* of each medium, 1 to 8; 0: 1 */
  uint32_t medium_count; /* At most the daemon's limit max_media, by default 64. For more media,
                            submit several queries: see dipole_submit(). */
  unsigned spacing;      /* enum dipole_spacing */
  const void *radii;     /* for LIST: [radius_count] of double (F64) or float, mm, 0 to infinity */
  uint64_t radius_count;
  double radius_start_mm;             /* the first radius, for LINEAR and LOGARITHMIC */
  double radius_stop_mm;              /* the last radius, for LINEAR and LOGARITHMIC */
  const dipole_parameter *parameters; /* [parameter_count], each id at most once; NULL for none */
  size_t parameter_count;
  /* How long the reply may take from the arrival of the query, in ms; 0 is no limit. The daemon
   * refuses a query that it cannot serve in this time, with the status `deadline`. */
  unsigned deadline_ms;
  /* Memory of the caller into which the arrays of the reply are copied as well; NULL: none.
   * into_values is [medium_count][wanted quantities that have an array][radius_count] of double or
   * float, with the quantities in the order of enum dipole_quantity. into_radii is [radius_count];
   * it is needed if DIPOLE_RADIUS is wanted. Do not touch this memory until the query is collected,
   * refused or given up, or the client is closed. It holds values only if the call that returns the
   * result succeeds. dipole_eval_parts() ignores both pointers. */
  void *into_values;
  void *into_radii;
} dipole_query;

/* Sets all fields of a query: the model transport, DIPOLE_LUT, DIPOLE_EXACT, DIPOLE_R, DIPOLE_LIST,
 * and 0 or NULL for all others. Then set at least the media and the radii, which are an array of
 * float unless you change the evaluator to DIPOLE_F64. A table of transport takes milliseconds to
 * prepare and then the least for a radius; it is within 1e-4 of the other evaluators. */
void dipole_query_init(dipole_query *query);

/* Where the power goes that has entered: shares, whose sum is 1. */
typedef struct dipole_balance {
  double reflected, transmitted; /* light that was scattered and leaves above, and below */
  double unscattered_above, unscattered_below; /* light that leaves without being scattered */
  double absorbed[8];                          /* by each layer, from the top down; else 0 */
} dipole_balance;

/* The relative errors of values. At radius r, a value is off from the model's formula by at most
 * numerical_error + numerical_error_per_mm * r. */
typedef struct dipole_errors {
  double numerical_error;        /* constant part of the numerical error */
  double numerical_error_per_mm; /* growth of the numerical error with the radius */
  double model_error; /* of the model against radiative transport; NaN if it is not known */
} dipole_errors;

/* The reply for one medium. An array is NULL if its quantity was not wanted or if its type is not
 * that of the evaluator: DIPOLE_F64 sets the arrays *_f64, the other evaluators set *_f32. */
typedef struct dipole_channel {
  double albedo; /* NaN if it was not wanted */
  /* A value at radius r is off from the model's formula by at most
   * numerical_error + numerical_error_per_mm * r, relative; for ln R, its derivatives, paths and modulated light this error
   * is absolute. */
  double numerical_error;
  double numerical_error_per_mm;
  /* The largest error of the wanted quantities against radiative transport, at the radii that were
   * requested, or of a sample at those between which all but 2e-6 of the light leaves. It is
   * relative, for ln R and the cdf absolute, for R_f over the albedo. NaN unless DIPOLE_MODEL_ERROR
   * was wanted, or if transport is not solved for the medium, or diverges at all radii (r = 0). */
  double model_error;
  const dipole_balance *balance; /* NULL if it was not wanted */
  const double *R_f64;           /* [radius_count], 1/mm^2 */
  const double *cdf_f64;         /* [radius_count] */
  const float *R_f32;
  const float *cdf_f32;
} dipole_channel;

typedef struct dipole_result {
  unsigned model, evaluator, moments, wanted; /* as the daemon used them */
  unsigned notes; /* sum of the ids of the notes (kind DIPOLE_NOTE) that hold for any channel */
  uint64_t radius_count;
  const double *radius_f64; /* [radius_count], mm; NULL unless DIPOLE_RADIUS was wanted */
  const float *radius_f32;
  uint32_t channel_count;
  const dipole_channel *channels; /* [channel_count], in the order of the query's media */
} dipole_result;

/* Evaluates a query and waits for the reply, which may have any size that fits into memory. The
 * caller frees *result with dipole_result_free(). The client keeps replies to submitted queries
 * that arrive meanwhile. */
bool dipole_eval(dipole_client *client, const dipole_query *query, dipole_result **result,
                 dipole_error *error);

/* Evaluates like dipole_eval(), but passes each part of the reply to part() as soon as it arrives
 * and keeps none, so that a reply may be larger than memory. The daemon chooses how many radii a
 * part has. A reply that fits into a frame (limit max_frame_bytes) is one part; a larger reply
 * has parts of up to max_part_bytes.
 *
 * *part is a result for part->radius_count radii, of which the first has position radius_first in
 * the query. All parts are alike except for their arrays. *part is valid until part() returns;
 * part() must neither free it nor use the client. The daemon waits while part() works.
 *
 * Returns true when part() has got all parts. Returns false if an error ended the reply; the parts
 * before the error are valid. If part() returns false, the call fails with kind STOPPED. The client
 * continues to work, but its later calls still have to receive the other parts and throw them away:
 * if many are left, it is better to close the client. */
bool dipole_eval_parts(dipole_client *client, const dipole_query *query,
                       bool (*part)(void *context, const dipole_result *part,
                                    uint64_t radius_first),
                       void *context, dipole_error *error);

void dipole_result_free(dipole_result *result); /* result may be NULL */

/* Returns the array [radius_count] of a quantity for a channel; the result owns it. Returns NULL if
 * the quantity was not wanted, if the evaluator has the other type, or if there is no such channel.
 * Also NULL for DIPOLE_ALBEDO, and for DIPOLE_RADIUS unless dipole_sample() made the result. */
const double *dipole_values_f64(const dipole_result *result, uint32_t channel, unsigned quantity);
const float *dipole_values_f32(const dipole_result *result, uint32_t channel, unsigned quantity);

/* Returns the errors of a wanted quantity of a channel. Those of a dipole_channel are the largest of
 * all its quantities. model_error is NaN unless DIPOLE_MODEL_ERROR was wanted. All are NaN if the
 * quantity was not wanted or if there is no such channel. */
dipole_errors dipole_errors_of(const dipole_result *result, uint32_t channel, unsigned quantity);

/* ---- many queries at once ------------------------------------------------------------------ */

/* A program can submit queries without waiting for the replies to earlier ones, and collect the
 * replies in any order:
 *
 *   for (i = 0; i < n; i++) { dipole_submit(client, &queries[i], &ids[i], &error) ... }
 *   for (i = 0; i < n; i++) { dipole_collect(client, &id, &result, &error) ... }
 *
 * Every call that waits also receives, even dipole_submit() when the daemon does not read. So the
 * program and the daemon never wait for each other forever. The replies that are not collected take
 * memory; in_flight_max limits their number. The library receives only during calls, so the daemon
 * may have to wait for a program that makes none. */

/* Submits a query and sets *id, which is never 0. The query and its radii are copied; into_values
 * and into_radii are not. Fails with kind FULL if in_flight_max queries are outstanding. After kind
 * TIMEOUT the query is not submitted. */
bool dipole_submit(dipole_client *client, const dipole_query *query, uint64_t *id,
                   dipole_error *error);

/* Sends the submitted queries that the library still holds back. Until a call waits, it may hold
 * back up to a quarter of the outstanding queries and up to 16 KiB. Call this function before the
 * program does other work for a while. */
void dipole_flush(dipole_client *client);

/* Waits for the reply to any outstanding query and sets *id to the id of that query. The caller
 * frees *result with dipole_result_free(). Kind REFUSED: the daemon refused query *id; the others
 * go on. Kind TIMEOUT: no reply came within call_timeout_ms; all queries go on. Kind ARGUMENT: no
 * query is outstanding. */
bool dipole_collect(dipole_client *client, uint64_t *id, dipole_result **result,
                    dipole_error *error);

/* Waits like dipole_collect(), for the query with this id. Kind ARGUMENT: it is not outstanding. */
bool dipole_collect_id(dipole_client *client, uint64_t id, dipole_result **result,
                       dipole_error *error);

/* Returns the number of queries that were submitted and not yet collected. */
size_t dipole_outstanding(const dipole_client *client);

/* ---- drawing radii ------------------------------------------------------------------------- */

/* How number u[i] of a query is given, for i from 0 to sample_count - 1. */
enum dipole_draw {
  DIPOLE_DRAW_LIST = 1,       /* numbers[i] */
  DIPOLE_DRAW_REGULAR = 2,    /* (i + 1/2) / sample_count */
  DIPOLE_DRAW_STRATIFIED = 3, /* (i + random number i that belongs to the seed) / sample_count */
  DIPOLE_DRAW_RANDOM = 4      /* random number sample_first + i that belongs to the seed */
};

typedef struct dipole_sample_query {
  unsigned model;     /* dipole_id(client, DIPOLE_MODEL, name) of a model that covers all radii */
  unsigned evaluator; /* enum dipole_evaluator. It sets the type of numbers, radii and values. */
  unsigned moments;   /* enum dipole_moments */
  unsigned wanted;    /* Sum of enum dipole_quantity. DIPOLE_RADIUS means the drawn radii; all other
                         quantities are evaluated at the drawn radii. */
  const dipole_medium *media; /* [medium_count][layer_count], as in dipole_query */
  uint32_t layer_count;
  uint32_t medium_count;
  unsigned draw;       /* enum dipole_draw. All channels get the same numbers. */
  const void *numbers; /* for LIST: [sample_count] of double (F64) or float, 0 to 1 included */
  uint64_t sample_count;
  uint64_t sample_first; /* for RANDOM: 0 to 2^52 */
  uint64_t seed;         /* for RANDOM and STRATIFIED; gives the same bits on every machine */
  const dipole_parameter *parameters; /* [parameter_count], as in dipole_query */
  size_t parameter_count;
  unsigned deadline_ms; /* as of an eval */
} dipole_sample_query;

/* Draws radii with a density in proportion to r R(r), and waits for the reply. A number u gives
 * the radius r with cdf(r) = u: 0 mm for u = 0, and INFINITY for u = 1. DIPOLE_PDF is in 1/mm;
 * pdf / (2 pi r) is the density of points per mm^2. In the result, radius_count is sample_count;
 * dipole_values_f64() or dipole_values_f32() give the radii of a channel for DIPOLE_RADIUS;
 * radius_f64 and radius_f32 are NULL. The caller frees *result with dipole_result_free(). */
bool dipole_sample(dipole_client *client, const dipole_sample_query *query, dipole_result **result,
                   dipole_error *error);

/* Computes the numbers begin to begin + n - 1 of a query whose draw is not LIST, in this process
 * and with the daemon's bits. u: [n] of double (F64) or float. */
bool dipole_sample_numbers(const dipole_sample_query *query, uint64_t begin, size_t n, void *u,
                           dipole_error *error);

/* ---- from albedos to coefficients ---------------------------------------------------------- */

/* The kinds of length by which a medium can be given. sigma_t' = sigma_a + sigma_s (1 - g). */
enum dipole_length {
  DIPOLE_MEAN_FREE_PATH = 1, /* 1 / sigma_t' */
  DIPOLE_DIFFUSE_MEAN_FREE_PATH =
      2, /* 1 / (sigma_t' sqrt(3 a / (1 + a))), a = sigma_a / sigma_t' */
  DIPOLE_CLASSICAL_DIFFUSE_PATH = 3, /* 1 / sqrt(3 sigma_a sigma_t') */
  DIPOLE_EXTINCTION_PATH = 4         /* 1 / (sigma_a + sigma_s), that of a random walk */
};

/* The light of a colour, which is a diffuse albedo. */
enum dipole_light {
  DIPOLE_BEAM = 1,   /* a beam at normal incidence */
  DIPOLE_DIFFUSE = 2 /* the same radiance from all directions, as in a furnace */
};

typedef struct dipole_invert_query {
  unsigned model;   /* the model of the albedos; its R must depend on the medium */
  unsigned moments; /* enum dipole_moments */
  unsigned given;   /* enum dipole_length: the kind of lengths_mm */
  unsigned light;   /* enum dipole_light of the albedos; 0 for DIPOLE_BEAM */
  bool specular;    /* whether the albedos contain what the surface itself reflects (Fresnel) */
  double g, eta;    /* of all media */
  const double *albedos;    /* [medium_count], 0 to 1: for a beam the integral of 2 pi r R(r) */
  const double *lengths_mm; /* [medium_count], 1e-14 to 1e14; for other units multiply */
  uint64_t medium_count; /* At least 1. The lists must fit into a frame (limit max_frame_bytes). For
                           a model that takes seconds to prepare, such as transport, the limit
                           max_media holds as well. */
  unsigned deadline_ms;  /* as of an eval */
} dipole_invert_query;

/* The media that were found. The arrays are [medium_count], in the order of the query, and have NaN
 * where there is no medium: if the model cannot reach the albedo, or if only a medium without
 * absorption has it and the length is a diffuse path, which is then infinite. */
typedef struct dipole_inversion {
  uint64_t medium_count;
  uint64_t missing_count; /* number of media that are NaN */
  const double *sigma_a_per_mm;
  const double *sigma_s_per_mm;
  const double *albedos; /* of these media under the model. They differ from the wanted ones by at
                            most 1e-12, relative, or a few units in the last place of the model. */
  double albedo_least;   /* the least above 0 that the model reaches with this g and eta */
  double albedo_most;    /* the largest albedo that the model reaches with this g and eta */
  const double *sigma_a_errors_per_mm; /* the most by which they are off the model's formula */
  const double *sigma_s_errors_per_mm;
  const double *model_errors; /* how far the albedos are from transport's, relative; NaN: unknown */
} dipole_inversion;

/* Finds the media that have the given albedos and lengths, and waits for the reply. The caller
 * frees *inversion with dipole_inversion_free(). */
bool dipole_invert(dipole_client *client, const dipole_invert_query *query,
                   dipole_inversion **inversion, dipole_error *error);

void dipole_inversion_free(dipole_inversion *inversion); /* inversion may be NULL */

/* ---- from readings to coefficients --------------------------------------------------------- */

/* Where the readings of a fit were taken. */
enum dipole_axis {
  DIPOLE_AXIS_RADIUS = 1,    /* at distances in mm; a reading is R in 1/mm^2 */
  DIPOLE_AXIS_FREQUENCY = 2, /* under striped light of spatial frequencies in 1/mm; it is R(f) */
};

/* What is known about the scale of the readings. */
enum dipole_scale {
  DIPOLE_ABSOLUTE = 1,  /* readings are R or R(f) themselves */
  DIPOLE_FREE = 2,      /* readings are R or R(f) times one unknown factor, which is fitted too */
  DIPOLE_REFERENCE = 3, /* readings are divided by those of a known medium at the same places */
};

/* How a fit has ended. Only DIPOLE_FITTED is a success. */
enum dipole_fit_status {
  DIPOLE_FITTED = 1,
  DIPOLE_FIT_AT_BOUND = 2,     /* the best medium is at the edge of those that are tried */
  DIPOLE_FIT_UNDETERMINED = 3, /* a whole line of media fits: see `condition` and the variances */
  DIPOLE_FIT_AMBIGUOUS = 4,    /* a second medium fits as well */
  DIPOLE_FIT_UNFINISHED = 5,   /* the search did not settle */
  DIPOLE_FIT_REFUSED = 6,      /* a reading is wrong: see `field` and `index` */
  DIPOLE_FIT_IMPLAUSIBLE = 7,  /* chi_squared is too large for the errors as stated */
};

typedef struct dipole_fit_query {
  unsigned model;      /* the model of the readings */
  unsigned moments;    /* enum dipole_moments */
  double g, eta;       /* of all media; an eta of 0 is refused, as there is no default */
  double thickness_mm; /* of all media; 0: half spaces */
  /* [parameter_count], as of an eval, and detector_na: the sine of the largest angle to the normal,
   * outside, at which light is detected. Without it, that of all angles is. */
  const dipole_parameter *parameters;
  size_t parameter_count;
  unsigned axis;           /* enum dipole_axis */
  unsigned scale;          /* enum dipole_scale */
  dipole_medium reference; /* for DIPOLE_REFERENCE: the known medium */
  uint64_t reading_count;  /* of each set: 2 to 1024, with DIPOLE_FREE at least 3 */
  const double *at;        /* [reading_count] distances in mm, or frequencies in 1/mm */
  const double *source_mm; /* [reading_count] diameters of the discs that emit the light and that */
  const double *detector_mm; /* detect it; NULL: 0 */
  uint64_t set_count;   /* At least 1. All sets must fit into a frame (limit max_frame_bytes). */
  const double *values; /* [set_count][reading_count]; noise may make some negative */
  const double *errors; /* [set_count][reading_count] their standard errors, above 0 and finite */
  bool residuals;       /* whether the residuals are wanted */
  unsigned deadline_ms; /* as of an eval */
} dipole_fit_query;

/* What was found for one set. With DIPOLE_FIT_REFUSED all from sigma_a_per_mm on is NaN. */
typedef struct dipole_fitted {
  uint16_t status; /* enum dipole_fit_status */
  uint16_t bounds; /* sum of: 1 least and 2 largest sigma_a / sigma_s' that is tried, 4 least and 8
                      largest sigma_s' */
  uint16_t field;  /* DIPOLE_FIT_REFUSED: what is wrong of a reading: 1 its value, 2 its error */
  uint16_t zero;
  uint32_t index; /* DIPOLE_FIT_REFUSED: the position of that reading in its set */
  uint32_t evaluations;
  double sigma_a_per_mm;
  double sigma_s_prime_per_mm; /* sigma_s (1 - g) */
  double factor;               /* of all readings; 1 unless the scale is DIPOLE_FREE */
  double chi_squared;
  double reduced_chi_squared; /* over readings less unknowns; NaN if there are as many unknowns */
  double condition; /* largest over least standard error along any direction of ln sigma_a and ln
                       sigma_s' */
  /* The squares of the standard errors of sigma_a, sigma_s' and the factor, and the covariances.
   * Those with the factor are 0 unless the scale is DIPOLE_FREE. */
  double variance_a, covariance_a_s, variance_s, covariance_a_factor, covariance_s_factor,
      variance_factor;
  /* A second medium, a local best, whose chi-squared is less than 9 above the best; NaN: none. */
  double second_sigma_a_per_mm, second_sigma_s_prime_per_mm, second_factor, second_chi_squared;
  /* The relative error of R of the best medium against radiative transport, at the distances of the
   * readings and between them: that of transport, and with detector_na that of the share that is
   * detected. With DIPOLE_REFERENCE it is that of the ratio. It is not part of the variances. NaN: it
   * is not known, as for every other model than transport. The numerical error of R, which
   * dipole_eval() states, is in neither: for transport with g other than 0 it may be 1e-3, and
   * more with sigma_a above sigma_s'. */
  double model_error;
} dipole_fitted;

typedef struct dipole_fits {
  uint64_t set_count;
  uint64_t fitted_count;     /* number of sets whose status is DIPOLE_FITTED */
  const dipole_fitted *sets; /* [set_count], in the order of the query */
  uint32_t reading_count;    /* of the residuals; 0 if they are not wanted */
  const double *residuals; /* [set_count][reading_count]: (value - factor model) / error, or NULL */
  unsigned notes;          /* sum of the bits of the notes that hold */
} dipole_fits;

/* Finds the media whose readings are most likely, and waits for the reply. The daemon prepares
 * what all sets have in common once, and keeps it. Beyond two mean free paths readings hardly
 * depend on g: repeat the call with g - 0.05 and g + 0.05 to see how much the coefficients change. The
 * caller frees *fits with dipole_fits_free(). */
bool dipole_fit(dipole_client *client, const dipole_fit_query *query, dipole_fits **fits,
                dipole_error *error);

void dipole_fits_free(dipole_fits *fits); /* fits may be NULL */

/* What a fit of layers seeks: bits, of the top layer (1) and of the layer below it. */
enum dipole_unknown {
  DIPOLE_SIGMA_A_1 = 1,
  DIPOLE_SIGMA_S_1 = 2,
  DIPOLE_THICKNESS_1 = 4,
  DIPOLE_SIGMA_A_2 = 8,
  DIPOLE_SIGMA_S_2 = 16,
  DIPOLE_THICKNESS_2 = 32,
};

typedef struct dipole_layers_query {
  const dipole_medium *layers; /* [layer_count]; what they say of the unknowns has no meaning */
  uint32_t layer_count;        /* 1 to 8 */
  unsigned unknowns;           /* sum of enum dipole_unknown */
  unsigned scale;              /* DIPOLE_ABSOLUTE or DIPOLE_FREE */
  uint64_t reading_count;      /* as many as there are unknowns, to 1024 */
  const double *at;            /* [reading_count] distances in mm */
  const double *values;        /* [reading_count] R in 1/mm^2 */
  const double *errors;        /* [reading_count] their standard errors */
  unsigned deadline_ms;        /* as of an eval */
} dipole_layers_query;

/* What was found of one unknown. */
typedef struct dipole_estimate {
  uint16_t unknown; /* enum dipole_unknown */
  uint16_t status;  /* DIPOLE_FITTED, DIPOLE_FIT_AT_BOUND or DIPOLE_FIT_UNDETERMINED */
  uint32_t zero;
  double value; /* 1/mm or mm; NaN if undetermined */
  double error; /* its standard error; infinity unless fitted */
} dipole_estimate;

typedef struct dipole_layers_fit {
  unsigned status; /* enum dipole_fit_status: DIPOLE_FITTED if all unknowns are */
  uint64_t estimate_count;
  const dipole_estimate *estimates; /* [estimate_count], in the order of their bits */
  double factor, factor_error;      /* of all readings; 1 and 0 unless the scale is DIPOLE_FREE */
  double chi_squared;
  double reduced_chi_squared; /* over readings less unknowns; NaN if there are as many unknowns */
  double numerical_error;     /* the largest one of R, relative, which is in no standard error */
  uint64_t reading_count;
  const double *residuals; /* [reading_count]: (value - factor R) / error */
} dipole_layers_fit;

/* Finds coefficients and thicknesses of the two upper layers of a stack from readings of R, by
 * transport, and waits for the reply, which takes 5 to 40 s. The caller frees *fit with
 * dipole_layers_fit_free(). */
bool dipole_fit_layers(dipole_client *client, const dipole_layers_query *query,
                       dipole_layers_fit **fit, dipole_error *error);

void dipole_layers_fit_free(dipole_layers_fit *fit); /* fit may be NULL */

/* ---- tissues ------------------------------------------------------------------------------- */

/* Published tables of haemoglobin's absorption, up to 31 % apart: say with results which it was. */
enum dipole_haemoglobin { DIPOLE_PRAHL = 1, DIPOLE_UCL = 2 };

typedef struct dipole_tissue_query {
  unsigned tissue;      /* dipole_id(client, DIPOLE_TISSUE, name), or 0 for none */
  unsigned haemoglobin; /* enum dipole_haemoglobin */
  /* What differs from that tissue: numbers by id, as dipole_id(client, DIPOLE_PROPERTY, "hbo2_uM").
   * Without a tissue, a_per_mm and b have to be there, and other amounts are 0. */
  const dipole_parameter *properties;
  size_t property_count;
  const double *wavelengths_nm; /* [wavelength_count] */
  uint32_t wavelength_count;    /* 1 to 1024 */
  unsigned deadline_ms;         /* as of an eval */
} dipole_tissue_query;

/* Finds the medium that a tissue is at each wavelength: sets media[wavelength_count]. The daemon
 * refuses a wavelength at which a spectrum or the scattering law is not known. */
bool dipole_tissue(dipole_client *client, const dipole_tissue_query *query, dipole_medium *media,
                   dipole_error *error);

/* What a fit of a tissue seeks: a property, between limits. */
typedef struct dipole_sought {
  uint16_t property; /* dipole_id(client, DIPOLE_PROPERTY, name): an amount, a_per_mm or b */
  uint16_t zero;
  uint32_t zero_too;
  double low, high; /* both 0: the usual limits */
} dipole_sought;

typedef struct dipole_tissue_fit_query {
  /* What is not sought, where the search starts, wavelengths. Unless given, g is 0.9, eta 1.4. */
  dipole_tissue_query tissue;
  unsigned model;              /* the model of the readings */
  unsigned axis;               /* enum dipole_axis */
  unsigned scale;              /* DIPOLE_ABSOLUTE or DIPOLE_FREE: one factor for all wavelengths */
  const dipole_sought *sought; /* [sought_count] */
  uint32_t sought_count;       /* 1 to 16 */
  uint32_t place_count;        /* at each wavelength: 1 to 1024, with the wavelengths up to 4096 */
  const double *at;            /* [place_count] distances in mm, or frequencies in 1/mm */
  const double *source_mm, *detector_mm; /* [place_count] diameters, as of a fit; NULL: 0 */
  /* [place_count] MHz of modulated light, and what is read: 0 R or its amplitude, DIPOLE_LAG in
   * degrees, or DIPOLE_MODULATION; NULL: 0 */
  const double *mhz, *quantity;
  double detector_na; /* as of a fit; 0: light of all angles */
  uint64_t set_count; /* at least 1 */
  /* [set_count][wavelength_count][place_count] readings and their standard errors */
  const double *values, *errors;
  bool residuals; /* whether the residuals are wanted */
} dipole_tissue_fit_query;

/* What was found for one set. With DIPOLE_FIT_REFUSED all numbers from saturation on are NaN. */
typedef struct dipole_fitted_tissue {
  uint16_t status; /* enum dipole_fit_status: DIPOLE_FITTED if all estimates are */
  uint16_t field;  /* DIPOLE_FIT_REFUSED: what is wrong of a reading: 1 its value, 2 its error */
  uint16_t saturation_status, total_status;
  uint32_t index; /* DIPOLE_FIT_REFUSED: the position of that reading in its set */
  uint32_t evaluations;
  double saturation, saturation_error; /* of haemoglobin, by the covariance; NaN: not known */
  double total_uM, total_error_uM;     /* oxyhaemoglobin and haemoglobin */
  double factor, factor_error;         /* of all readings; 1 and 0 unless DIPOLE_FREE */
  double chi_squared;
  double reduced_chi_squared; /* over readings less unknowns; NaN if there are as many unknowns */
  double condition;
  double numerical_error, model_error; /* the largest ones of R, relative; NaN: not known */
} dipole_fitted_tissue;

typedef struct dipole_tissue_estimate {
  uint16_t property;
  uint16_t status; /* enum dipole_fit_status */
  uint32_t zero;
  double value;     /* in the unit of the property; NaN if undetermined */
  double error;     /* its standard error; infinity unless fitted or unfinished */
  double numerical; /* how far numerical errors of R may shift it */
} dipole_tissue_estimate;

typedef struct dipole_tissue_fits {
  uint64_t set_count, fitted_count;
  uint32_t sought_count, reading_count;    /* reading_count: of the residuals, or 0 */
  unsigned haemoglobin;                    /* enum dipole_haemoglobin */
  double g, eta;                           /* of all media */
  const dipole_fitted_tissue *sets;        /* [set_count], in the order of the query */
  const dipole_tissue_estimate *estimates; /* [set_count][sought_count], by ids of properties */
  const double *covariance;                /* [set_count][sought_count][sought_count] */
  const double *residuals; /* [set_count][reading_count]: (value - factor R) / error, or NULL */
} dipole_tissue_fits;

/* Finds amounts of chromophores and scattering from readings at several wavelengths. The caller
 * frees *fits with dipole_tissue_fits_free(). */
bool dipole_fit_tissue(dipole_client *client, const dipole_tissue_fit_query *query,
                       dipole_tissue_fits **fits, dipole_error *error);

void dipole_tissue_fits_free(dipole_tissue_fits *fits); /* fits may be NULL */

/* ---- tables -------------------------------------------------------------------------------- */

/* The table that the evaluator DIPOLE_LUT uses for one medium. The library evaluates it in this
 * process, with the daemon's bits. It never changes: any number of threads may use it at once. */
typedef struct dipole_table dipole_table;

typedef struct dipole_table_query {
  unsigned model;   /* dipole_id(client, DIPOLE_MODEL, name) */
  unsigned moments; /* enum dipole_moments */
  dipole_medium medium;
  const dipole_medium *layers; /* [layer_count], in place of `medium`; NULL: none */
  uint32_t layer_count;
  const dipole_parameter *parameters; /* [parameter_count], as in dipole_query: tolerance, ... */
  size_t parameter_count;
  unsigned deadline_ms; /* as of an eval */
} dipole_table_query;

/* The facts that hold for all values of a table. The table owns them. */
typedef struct dipole_table_info {
  unsigned layout; /* see proto/PROTOCOL.md, "table" */
  unsigned model, moments;
  unsigned notes;       /* sum of the ids of the notes (kind DIPOLE_NOTE) that hold for the table */
  dipole_medium medium; /* its top layer */
  const dipole_medium *layers; /* [layer_count] */
  uint32_t layer_count;
  const dipole_parameter *parameters; /* [parameter_count]: the parameters of the query */
  size_t parameter_count;
  double albedo; /* integral of 2 pi r R(r) over all radii */
  /* A value at radius r, up to reach_mm, is off from the model's formula by at most numerical_error
   * + numerical_error_per_mm * r, relative, as measured between all nodes. model_error holds at all
   * radii that the model covers: it is 0 for transport and NaN, which means not known, for other
   * models. dipole_table_errors() has the errors for the radii of a call. */
  double numerical_error;
  double numerical_error_per_mm;
  double model_error;
  double pieces_from_mm;  /* Below this radius the table uses an asymptotic formula. */
  double pieces_to_mm;    /* From this radius on the table uses an asymptotic formula. */
  double radius_least_mm; /* the range of radii that the model covers, both ends included */
  double radius_most_mm;
  const uint32_t *words; /* [word_count]: the bits of single precision numbers and of entries */
  size_t word_count;
  /* At larger radii, R and the pdf have larger errors than numerical_error says. INFINITY for all
   * models except transport. */
  double reach_mm;
} dipole_table_info;

/* Fetches a table from a daemon. The caller frees *table with dipole_table_free(). */
bool dipole_table_fetch(dipole_client *client, const dipole_table_query *query,
                        dipole_table **table, dipole_error *error);

/* Makes a table of bytes that dipole_table_bytes() returned, at any alignment. It copies them. It
 * ignores bytes behind the table, so a file may hold several tables in a row. Fails with kind TABLE
 * if the bytes are damaged or have an unknown layout. No bytes, however wrong, make the library
 * read outside of the table. The caller frees *table with dipole_table_free(). */
bool dipole_table_load(const void *bytes, size_t count, dipole_table **table, dipole_error *error);

/* Returns the table as *count bytes, for saving: the whole frame of the daemon's reply, which is
 * the same on every machine. The table owns the bytes. */
const void *dipole_table_bytes(const dipole_table *table, size_t *count);

const dipole_table_info *dipole_table_get_info(const dipole_table *table);

/* Evaluates DIPOLE_R, DIPOLE_CDF, DIPOLE_PDF, DIPOLE_RING, or DIPOLE_S for the parameters cos_in
 * and cos_out of the query. r: [n] in mm, from 0 to infinity. out: [n] in the quantity's unit. The
 * arrays must not overlap. Returns false and does not write to out if the table does not have the
 * quantity, or if a radius is NaN, negative or not covered by the model. */
bool dipole_table_values(const dipole_table *table, enum dipole_quantity quantity, size_t n,
                         const float *r, float *out);

/* States the errors of quantities at the radii of a call: the numerical errors are exactly those that a
 * daemon states for an eval of this medium and model with DIPOLE_LUT and the same radii, and the model
 * error is the largest in the bands of radii that hold them. wanted: sum of DIPOLE_ALBEDO
 * and the quantities of dipole_table_values(). r: [n] in mm; only the smallest and the largest
 * finite radius matter, so the two ends stand for all radii between them. Returns false and leaves
 * *errors as it was if dipole_table_values() would refuse a quantity or a radius. */
bool dipole_table_errors(const dipole_table *table, unsigned wanted, size_t n, const float *r,
                         dipole_errors *errors);

/* Computes the radii r[n] in mm with cdf(r) = u: random u give radii that are distributed as the
 * light. u: [n] from 0 to 1, both included; 1 gives INFINITY. All radii are 0 if the medium does
 * not scatter. The arrays must not overlap. Returns false and leaves r if a u is out of range. */
bool dipole_table_radii(const dipole_table *table, size_t n, const float *u, float *r);

void dipole_table_free(dipole_table *table); /* table may be NULL */

/* Returns the models, quantities and other choices that are built into the library, and the
 * instruction set with which it evaluates tables. This needs no daemon; address is "". The caller
 * frees *info, which is one block, with free(). */
bool dipole_local_info(dipole_info **info, dipole_error *error);

/* ---- media that vary ----------------------------------------------------------------------- */

/* A query in which every value has its own medium, as the shading points of a texture have.
 * The model, g and eta are those of all values. A value costs some ten nanoseconds. */

/* The coefficients of a medium that a query can request. */
enum dipole_coefficient {
  DIPOLE_SIGMA_A = 1,  /* 1/mm */
  DIPOLE_SIGMA_S = 2,  /* 1/mm */
  DIPOLE_SCATTERED = 4 /* sigma_s / (sigma_a + sigma_s): the single-scattering albedo, which random
                          walks use */
};

/* What became of a value. The choices of kind DIPOLE_VALUE have all statuses: their names, and what
 * is allowed in the field that they name. */
enum dipole_value_status {
  DIPOLE_VALUE_OK = 0, /* computed, within the errors that the result states */
  DIPOLE_VALUE_FAR = 1 /* computed, but at a radius beyond which no error is stated */
};

/* All arrays are [value_count] of double (F64) or float (F32). */
typedef struct dipole_varying_query {
  unsigned model;        /* dipole_id(client, DIPOLE_MODEL, name): transport, a dipole or burley */
  unsigned evaluator;    /* DIPOLE_F64 or DIPOLE_F32 */
  unsigned moments;      /* enum dipole_moments */
  unsigned wanted;       /* sum of DIPOLE_R, ALBEDO, CDF, PDF, RING, and with `numbers` RADIUS */
  unsigned coefficients; /* sum of enum dipole_coefficient that are wanted */
  double g, eta;         /* of all media */
  /* The media: either both coefficients, or colours with lengths. The others are NULL. */
  const void *sigma_a_per_mm;
  const void *sigma_s_per_mm;
  const void *colours; /* 0 to 1 */
  const void *lengths_mm;
  unsigned given; /* with colours: enum dipole_length, the kind of lengths_mm; else 0 */
  unsigned light; /* with colours: enum dipole_light; else 0 */
  bool specular;  /* whether the colours contain what the surface itself reflects (Fresnel) */
  /* At most one of these; without one, only DIPOLE_ALBEDO and coefficients may be wanted. */
  const void *radii;   /* mm, 0 to infinity: one for each value */
  const void *numbers; /* u, 0 to 1: radii are drawn, whose cdf is u */
  uint64_t value_count;
  const dipole_parameter *parameters; /* [parameter_count], as in dipole_query. The tolerance bounds
                                         the error of transport: at least 1e-5, by default 1e-3. */
  size_t parameter_count;
  unsigned deadline_ms; /* as of an eval */
} dipole_varying_query;

typedef struct dipole_varying_result {
  unsigned model, evaluator, moments, wanted, coefficients; /* as in the query */
  unsigned notes; /* sum of the ids of the notes (kind DIPOLE_NOTE) that hold */
  uint64_t value_count;
  uint64_t computed_count; /* number of values that were computed; the others are NaN */
  const uint8_t *statuses; /* [value_count]: enum dipole_value_status, or the id of a fault */
  double numerical_error;  /* relative, of all values whose status is DIPOLE_VALUE_OK */
  double model_error;  /* against radiative transport, relative; NaN unless DIPOLE_MODEL_ERROR was
                              wanted, or if transport is not solved for the media */
  double colour_least; /* the range of colours that media have, as in the query; NaN if the */
  double colour_most;  /* query has none */
  double specular;     /* the share of the light that the surface reflects; NaN likewise */
} dipole_varying_result;

/* Evaluates a query and waits for the reply. The arrays of a request must fit into a frame (limit
 * max_frame_bytes); its reply may have any size. The caller frees *result with
 * dipole_varying_result_free(). A value that cannot be computed is no error of the query. */
bool dipole_varying(dipole_client *client, const dipole_varying_query *query,
                    dipole_varying_result **result, dipole_error *error);

/* What a client needs to evaluate a model for all media of one g and eta: the words that a daemon
 * shares between them. A surface never changes: any number of threads may use it at once. */
typedef struct dipole_surface dipole_surface;

/* Fetches a surface: a table for one g and eta, whose albedo and radius vary from value to value. So
 * sigma_a_per_mm and sigma_s_per_mm of query->medium are 0. The caller frees *surface with
 * dipole_surface_free(). */
bool dipole_surface_fetch(dipole_client *client, const dipole_table_query *query,
                          dipole_surface **surface, dipole_error *error);

/* Makes a surface of bytes that dipole_surface_bytes() returned, like dipole_table_load(). */
bool dipole_surface_load(const void *bytes, size_t count, dipole_surface **surface,
                         dipole_error *error);

/* Returns the surface as *count bytes, for saving. The surface owns the bytes. */
const void *dipole_surface_bytes(const dipole_surface *surface, size_t *count);

void dipole_surface_free(dipole_surface *surface); /* surface may be NULL */

/* Evaluates a query in this process, without a daemon and with its bits. Model, moments, g, eta and
 * parameters of the query are those of the surface. */
bool dipole_varying_at_home(const dipole_surface *surface, const dipole_varying_query *query,
                            dipole_varying_result **result, dipole_error *error);

/* Return the array [value_count] of a quantity or of a coefficient, which the result owns. NULL if
 * it was not wanted, or if the evaluator has the other type. */
const double *dipole_varying_f64(const dipole_varying_result *result, unsigned quantity);
const float *dipole_varying_f32(const dipole_varying_result *result, unsigned quantity);
const double *dipole_coefficients_f64(const dipole_varying_result *result, unsigned coefficient);
const float *dipole_coefficients_f32(const dipole_varying_result *result, unsigned coefficient);

void dipole_varying_result_free(dipole_varying_result *result); /* result may be NULL */

/* ---- light gathered from points ------------------------------------------------------------ */

/* Sums the light that points leave at other positions x of a surface: M(x) is the sum of R(|x - xi|)
 * times the power of point i, over all points, for each channel (Jensen and Buhler 2002). The daemon
 * lets groups of points stand for their points where that is known to keep the tolerance. */

/* A set of points that hold power, named by its content. */
typedef struct dipole_points dipole_points;

/* Makes a set of points and computes its name, in about a second for 1 GB. xyz_mm:
 * [point_count][3], from -1e9 to 1e9. power_W: [point_count][channel_count], from 0 to 1e30:
 * irradiance times area. Both arrays stay the caller's, and must stay as they are until the caller
 * frees *points with dipole_points_free(). A set has 1 to 16777216 points of 1 to 8 channels. */
bool dipole_points_make(uint64_t point_count, uint32_t channel_count, const double *xyz_mm,
                        const float *power_W, dipole_points **points, dipole_error *error);

void dipole_points_free(dipole_points *points); /* points may be NULL */

typedef struct dipole_gather_query {
  unsigned model;     /* dipole_id(client, DIPOLE_MODEL, name) */
  unsigned evaluator; /* enum dipole_evaluator */
  unsigned moments;   /* enum dipole_moments */
  const dipole_points *points;
  const dipole_medium *media; /* [channels of the points][layer_count], as in dipole_query */
  uint32_t layer_count;
  const double *queries_mm; /* [query_count][3], from -1e9 to 1e9 */
  uint64_t query_count;
  /* The largest error that groups of points may cause, relative to M, at each query and in each
   * channel: 1e-9 to 0.5; or 0, so that each point is summed by itself. */
  double tolerance;
  const dipole_parameter *parameters; /* [parameter_count], as in dipole_query */
  size_t parameter_count;
  unsigned deadline_ms; /* of the whole call, the sending of points included; 0 is no limit */
} dipole_gather_query;

typedef struct dipole_gather_result {
  uint64_t computed_count;   /* fewer than query_count only if progress() returned false */
  double bound;              /* the largest error that groups of points have caused, at most */
  double numerical_error[8]; /* of each channel: by the evaluator and by rounding, relative */
  double model_error[8];     /* of each channel: of R against radiative transport at 0.01 to 20 mean
                                free paths, relative; NaN if transport is not solved */
  uint64_t points_visited;   /* points that were summed one by one */
  uint64_t nodes_visited;    /* groups that stood for their points */
  unsigned notes; /* sum of the ids of the notes (kind DIPOLE_NOTE) that hold for any channel */
} dipole_gather_result;

/* Gathers light at all queries and waits for it. M_W_per_mm2: [query_count][channels]. progress(),
 * unless NULL, is called whenever some thousand more queries are computed; it must not use the
 * client. If it returns false, the call ends, with what the daemon still does for it, and the sums
 * that are missing are NaN. result may be NULL.
 *
 * The points are sent to a daemon that does not have them, and again to one that has lost them, or
 * that takes over from a daemon that has ended: neither is an error of the call. The number of
 * queries is not limited; that of points is the daemon's limit max_points. */
bool dipole_gather(dipole_client *client, const dipole_gather_query *query,
                   bool (*progress)(void *context, uint64_t done, uint64_t count), void *context,
                   double *M_W_per_mm2, dipole_gather_result *result, dipole_error *error);

/* Gathers in this process, without a daemon, on one thread: with the bits that a daemon gives with
 * DIPOLE_LUT, for the models, moments, media and parameters of the tables. tables: one for each
 * channel of the points; their models have to cover all radii. The other arguments are as of
 * dipole_gather(); there are fewer than 2^32 queries. Each call builds the points anew, in about a
 * second for a million, and takes up to 300 bytes for each point of three channels meanwhile. */
bool dipole_gather_at_home(const dipole_table *const *tables, const dipole_points *points,
                           double tolerance, uint64_t query_count, const double *queries_mm,
                           bool (*progress)(void *context, uint64_t done, uint64_t count),
                           void *context, double *M_W_per_mm2, dipole_gather_result *result,
                           dipole_error *error);

/* ---- Monte Carlo --------------------------------------------------------------------------- */

/* A Monte Carlo job: the daemon walks photons through a medium until they are enough or the errors
 * are small enough. The same query gives the same bits unless the job is cancelled or cut off. */
typedef struct dipole_mc_query {
  dipole_medium medium;
  const dipole_medium *layers; /* [layer_count], in place of `medium`; NULL: none */
  uint32_t layer_count;
  const double *albedos;  /* [albedo_count] albedos of single scattering, 0 to 1, in place of the
                             medium's own. One walk gives the results for all of them. */
  unsigned albedo_count;  /* 0 to 16; 0 means the medium's own albedo */
  unsigned spacing;       /* of the rings' edges: DIPOLE_LINEAR or DIPOLE_LOGARITHMIC */
  uint32_t ring_count;    /* 1 to 4096 */
  double radius_start_mm; /* inner edge of the first ring */
  double radius_stop_mm;  /* outer edge of the last ring */
  uint64_t seed;
  uint64_t photons;   /* at least 1, at most the daemon's limit max_mc_photons */
  double error_total; /* The job ends when the relative standard error of the total R is at most
                         this; 0 means no such end. If both errors are given, both must hold. */
  double error_rings; /* The job ends when that of every ring with light is at most this. */
  /* [parameter_count]: phase, whose values are the ids of the choices of kind DIPOLE_PHASE,
   * phase_share and phase_g, without which the phase function is Henyey and Greenstein's; and
   * detector_na, as of a fit: rings then count detected light, totals all light. NULL for none. */
  const dipole_parameter *parameters;
  size_t parameter_count;
} dipole_mc_query;

enum dipole_mc_side { DIPOLE_MC_REFLECTED, DIPOLE_MC_TRANSMITTED, DIPOLE_MC_SIDES };

typedef struct dipole_mc_progress {
  uint64_t photons;          /* number of photons walked so far */
  uint64_t photons_expected; /* estimate of how many the job walks in all */
  double error_total;        /* relative standard error of the total R, largest of all albedos */
  double error_rings;        /* the error of the worst ring with light; INFINITY: not known yet */
  double worst_from_mm;      /* inner edge of the worst ring; both edges are 0 if there is none */
  double worst_to_mm;
  unsigned worst_side;   /* enum dipole_mc_side: the side of the worst ring */
  unsigned worst_albedo; /* position of the albedo for which the ring is the worst */
} dipole_mc_progress;

/* A fraction of the power that entered the medium, and its standard error. */
typedef struct dipole_mc_value {
  double value;
  double error;
} dipole_mc_value;

/* The energy balance for one albedo. The arrays are indexed by enum dipole_mc_side. */
typedef struct dipole_mc_energy {
  double albedo;
  dipole_mc_value R; /* leaves where light enters: unscattered + under + all rings + over */
  dipole_mc_value T; /* leaves on the other side of a slab: the same sum */
  dipole_mc_value absorbed;
  dipole_mc_value unfinished; /* was still inside when the walk of its photon was cut off */
  dipole_mc_value roulette;   /* added by Russian roulette minus what roulette removed; about 0 */
  double unscattered[DIPOLE_MC_SIDES];    /* leaves at r = 0 and counts in no ring; exact */
  dipole_mc_value under[DIPOLE_MC_SIDES]; /* leaves within the inner edge of the first ring */
  dipole_mc_value over[DIPOLE_MC_SIDES];  /* leaves beyond the outer edge of the last ring */
  dipole_mc_value in_layer[8];            /* absorbed in each layer, from the top down; else 0 */
  double imbalance; /* R + T + absorbed + unfinished - roulette - 1, which is 0 up to rounding */
} dipole_mc_energy;

enum dipole_mc_end {
  DIPOLE_MC_PHOTONS = 1, /* All photons have been walked. */
  DIPOLE_MC_ERRORS,      /* The errors are small enough. */
  DIPOLE_MC_CANCELLED,   /* The caller cancelled the job. The result holds the photons so far. */
  DIPOLE_MC_STOPPED,     /* The daemon stopped, and the client does not retry, or the caller had
                            cancelled the job. The result holds the photons so far. */
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

/* Starts a job and waits for its result. progress(), unless NULL, is called a few times a second;
 * it must not use the client. The count of photons begins anew if the client has to request the job
 * again: see dipole_set_retry_ms(). If progress() returns false, the job is cancelled, and the
 * result is of the photons walked by then. The caller frees *result with dipole_mc_result_free(). */
bool dipole_mc(dipole_client *client, const dipole_mc_query *query,
               bool (*progress)(void *context, const dipole_mc_progress *now), void *context,
               dipole_mc_result **result, dipole_error *error);

void dipole_mc_result_free(dipole_mc_result *result); /* result may be NULL */

/* These functions return arrays [ring_count], which the result owns, or NULL if there is no such
 * albedo or side. Values: the mean over each ring of the power that leaves, in 1/mm^2 per unit of
 * power that entered. Errors: their standard errors. Photons: how many left in each ring. */
const double *dipole_mc_values(const dipole_mc_result *result, uint32_t albedo,
                               enum dipole_mc_side side);
const double *dipole_mc_errors(const dipole_mc_result *result, uint32_t albedo,
                               enum dipole_mc_side side);
const uint64_t *dipole_mc_photons(const dipole_mc_result *result, enum dipole_mc_side side);

/* ---- media, statistics, ping --------------------------------------------------------------- */

/* A medium with a name. Its three channels are red, green and blue: `channel` and layer_count are
 * the media and layer_count of a query with three media. */
typedef struct dipole_measured_medium {
  char name[17];
  uint32_t layer_count;
  dipole_medium channel[3 * 8]; /* [3][layer_count] */
} dipole_measured_medium;

/* Requests the media that the daemon knows by name. free() frees *media, an array of *count. */
bool dipole_media(dipole_client *client, dipole_measured_medium **media, size_t *count,
                  dipole_error *error);

/* Requests the daemon's statistics. The caller frees *values, an array of *count, with free(). The
 * names are in the same block. */
bool dipole_statistics(dipole_client *client, dipole_value **values, size_t *count,
                       dipole_error *error);

/* Makes an empty round trip, which shows that the daemon replies. */
bool dipole_ping(dipole_client *client, dipole_error *error);

/* ---- any message --------------------------------------------------------------------------- */

/* A field of a request or one of its arrays, by its name in PROTOCOL.md. */
typedef struct dipole_field {
  const char *name;
  double number;        /* of a field: a number, an id or a sum of ids */
  const void *elements; /* of an array: [count]; parameters and properties are dipole_parameter */
  uint64_t count;
} dipole_field;

typedef struct dipole_reply dipole_reply;

/* Sends the message of this name, such as "tissue", whose reply is one frame, and waits for the reply.
 * What is not given has its default, or is counted. Frees *reply with dipole_reply_free(). */
bool dipole_call(dipole_client *client, const char *message, const dipole_field *fields,
                 size_t field_count, unsigned deadline_ms, dipole_reply **reply,
                 dipole_error *error);

/* Return a field, or NaN, and the elements of an array, or NULL if it has none. */
double dipole_reply_number(const dipole_reply *reply, const char *field);
const void *dipole_reply_array(const dipole_reply *reply, const char *name, uint64_t *count);

void dipole_reply_free(dipole_reply *reply); /* reply may be NULL */

#ifdef __cplusplus
}
#endif

#endif
