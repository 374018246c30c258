/* session: what one SCPI client has set, its jobs, and the answers to its message. Each connection has
 * a session of its own, so clients do not meet. Call all functions on the worker's thread.
 *
 * A message is carried out unit by unit. A query of values starts a job, which the connection waits
 * for. A fit and Monte Carlo are overlapped: later units are carried out while they run, up to a *WAI
 * or *OPC?. An error ends its message, so that no value follows from settings that were refused.
 */
#ifndef DIPOLED_SCPI_SESSION_H
#define DIPOLED_SCPI_SESSION_H

#include "core/tissue/tissue.h"
#include "proto/fit.h"
#include "server/jobs/call.h"
#include "server/scpi/parse.h"
#include "server/scpi/status.h"

enum scpi_task_index { SCPI_EVAL, SCPI_FIT, SCPI_SPECTRUM, SCPI_MC, SCPI_TASKS };

/* Lists of numbers that the client has sent. GIVEN: with the unit that is being carried out. */
enum scpi_list {
  SCPI_GIVEN,
  SCPI_RADII,
  SCPI_PLACES,
  SCPI_READINGS,
  SCPI_DEVIATIONS,
  SCPI_WAVELENGTHS,
  SCPI_MHZ,
  SCPI_QUANTITIES,
  SCPI_LISTS
};

/* What *RST sets to the defaults. */
enum { SCPI_NORMAL, SCPI_SWAPPED };
struct scpi_settings {
  wire_eval_request eval;
  fit_start fit;
  wire_mc_request mc;
  wire_medium layers[CORE_LAYERS_MAX];
  unsigned layer_count;
  const core_measured_medium *named; /* whose channel the layers are; NULL: none */
  uint32_t channel;                  /* from 1 on */
  wire_medium reference;
  core_parameters parameters;
  wire_tissue_request tissue;              /* without its counts */
  double properties[CORE_PROPERTIES_END];  /* NaN: as the tissue has it */
  double wavelength_nm;                    /* that the medium was made for */
  wire_sought sought[CORE_PROPERTIES_END]; /* of a spectrum, by their ids; id 0: it is not sought */
  enum scpi_format { SCPI_ASCII, SCPI_REAL_32, SCPI_REAL_64 } format;
  uint32_t order; /* of bytes in blocks: SCPI_NORMAL is big-endian */
};

struct scpi_session {
  struct client *client; /* the connection */
  struct server *server;
  struct scpi_settings settings;
  struct scpi_status status;
  struct text lists[SCPI_LISTS];        /* numbers of type double */
  struct call tasks[SCPI_TASKS];        /* the reply is that of the last job, or empty */
  wire_quantity_error errors;           /* of the last eval */
  bool completes;                       /* whether *OPC waits */
  const struct scpi_command *command;   /* the last one, which says at which node the next one is */
  const struct scpi_command *waits_for; /* whose job gives the answer; NULL: none */
  double wavelength_before_nm;          /* of MED:WAV, which a refused one leaves */
  bool held;                            /* whether a unit waits for the overlapped jobs */
  struct text answers;                  /* to the message so far, without its newline */
};

void scpi_session_init(struct scpi_session *session, struct client *client, struct server *server);
void scpi_session_free(struct scpi_session *session);

/* Carries out the unit of a message that begins at *at, and moves *at behind it. Returns false when
 * the message ends, and leaves *at alone if the unit waits: `waits_for` or `held` is then set. */
bool scpi_session_step(struct scpi_session *session, const char *message, size_t count, size_t *at);

/* Ends the answers of a message. */
void scpi_session_end_message(struct scpi_session *session);

/* Whether a fit or Monte Carlo is under way. */
bool scpi_session_measures(const struct scpi_session *session);

/* Called in the client's turns: lets jobs go on. */
void scpi_session_run(struct scpi_session *session, uint64_t *budget);

/* Called when the worker has evaluated the batch: takes the results of jobs that have ended. Returns
 * false if the message ends, because its job was refused. */
bool scpi_session_finish(struct scpi_session *session);

/* all: drops fit and Monte Carlo without results; else ends Monte Carlo soon, with results. */
void scpi_session_stop(struct scpi_session *session, bool all);

#endif
