/* request: from a well-formed frame to its answer. Independent of sockets. */
#ifndef DIPOLED_REQUEST_H
#define DIPOLED_REQUEST_H

#include "server/job.h"
#include "server/mc.h"
#include "server/output.h"

enum request_outcome {
  REQUEST_ANSWERED, /* the answer, or an error, has been committed to the output, or a Monte Carlo
                       job will answer */
  REQUEST_STARTED,  /* *job is to be run; its reply has been reserved */
  REQUEST_NO_ROOM,  /* not even an error could be put into the output */
};

/* Answers a frame, or starts the job that will. The payload has to stay while *job runs; Monte
 * Carlo jobs are started for the caller `mc` and need it no more. */
enum request_outcome request_begin(struct server *server, const wire_header *header,
                                   const uint8_t *payload, struct output *output, struct job *job,
                                   const struct mc_caller *mc);

/* Room for a frame in the output, to be committed: its header is written, its payload returned.
 * NULL: there is none. */
uint8_t *request_begin_frame(struct output *output, unsigned type, uint64_t request_id,
                             size_t payload_bytes);

/* Commits an error frame; false: there was no room for it. */
bool request_refuse(struct server *server, uint64_t request_id, const wire_error *error,
                    struct output *output);

#endif
