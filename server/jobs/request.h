/* request: from a well-formed frame to its answer. Independent of sockets. */
#ifndef DIPOLED_REQUEST_H
#define DIPOLED_REQUEST_H

#include "server/jobs/invert_job.h"
#include "server/jobs/job.h"
#include "server/jobs/mc.h"
#include "server/net/output.h"
#include "server/jobs/table_job.h"

enum request_outcome {
  REQUEST_ANSWERED,       /* the answer has been committed to the output */
  REQUEST_REFUSED,        /* an error has */
  REQUEST_BEGUN,          /* a Monte Carlo job will answer */
  REQUEST_STARTED,        /* the job is to be run; its reply has been reserved */
  REQUEST_TABLE_STARTED,  /* the table job is to be run */
  REQUEST_INVERT_STARTED, /* the invert job is to be run; its reply has been reserved */
  REQUEST_NO_ROOM,        /* not even an error could be put into the output */
};

/* Where what a request starts has its place. */
struct request_place {
  struct job *job;
  struct table_job *table;
  struct invert_job *invert;
  struct job_scratch *scratch; /* of the worker */
  const struct mc_caller *mc;  /* for whom Monte Carlo jobs are started */
};

/* Answers a frame, or starts the job that will. The payload has to stay while *job or *invert
 * runs; the others need it no more. */
enum request_outcome request_begin(struct server *server, const wire_header *header,
                                   const uint8_t *payload, struct output *output,
                                   const struct request_place *place);

/* Room for a frame in the output, to be committed: its header is written, its payload returned.
 * NULL: there is none. */
uint8_t *request_begin_frame(struct output *output, unsigned type, uint64_t request_id,
                             size_t payload_bytes);

/* Commits an error frame; false: there was no room for it. */
bool request_refuse(struct server *server, uint64_t request_id, const wire_error *error,
                    struct output *output);

#endif
