/* table_job: one table request being answered. */
#ifndef DIPOLED_TABLE_JOB_H
#define DIPOLED_TABLE_JOB_H

#include "proto/table.h"
#include "server/jobs/job_state.h"
#include "server/net/output.h"
#include "server/store/profiles.h"

struct table_job {
  table_request request;
  struct profiles_order order; /* for the table */
  wire_error refusal;
};

/* Checks all of a request and, when it is right, starts the job; the payload is needed no more. */
wire_error table_job_start(struct table_job *job, const uint8_t *payload, size_t payload_bytes);

/* Goes on with it: WAITS, DONE or REFUSED. request_id: of its frame. */
enum job_state table_job_run(struct table_job *job, struct profiles *profiles, uint64_t request_id,
                             struct output *output);

/* Lets go of what it holds or waits for. */
void table_job_end(struct table_job *job);

#endif
