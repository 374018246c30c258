#include "server/repeat.h"

#include <math.h>
#include <string.h>

/* What stands before the arrays of a reply with one channel. */
enum { REPLY_BYTES = WIRE_BYTES_eval_reply + WIRE_BYTES_channel };

_Static_assert((int)REPLY_BYTES == (int)JOB_REPEAT_REPLY_BYTES, "as much is kept");

static size_t value_bytes(const struct job *job) {
  return eval_value_bytes(job->request.fixed.evaluator);
}

/* Bytes of a request before its radii. */
static size_t start_bytes(const struct job *job) {
  const wire_eval_request *fixed = &job->request.fixed;
  return (size_t)eval_request_bytes(fixed->medium_count, fixed->parameter_count, 0);
}

/* One medium, one part, short, and nothing that looks at the radii but the kernels; and S, whose angles
 * are not the profile's own. */
static bool may_repeat(const struct job *job) {
  const wire_eval_request *fixed = &job->request.fixed;
  return fixed->medium_count == 1 && job->part_count == 1 && job->count > 0 &&
         job->count <= BATCH_SHORT_RADII && job->covers_all && isnan(job->tolerance) &&
         (fixed->wanted & (CORE_QUANTITY_RADIUS | CORE_QUANTITY_S)) == 0 &&
         start_bytes(job) <= sizeof job->repeat.request &&
         (job->order.entry != NULL || core_profile_bytes(&job->order.profile) == 0);
}

bool repeat_learn(struct job *job) {
  if (!may_repeat(job)) {
    return false;
  }
  const uint8_t *payload = job->request.media - WIRE_BYTES_eval_request;
  const uint64_t listed = job->request.radii != NULL ? job->count * value_bytes(job) : 0;
  job->repeat.request_bytes = start_bytes(job);
  job->repeat.payload_bytes = job->repeat.request_bytes + (size_t)wire_padded(listed);
  memcpy(job->repeat.request, payload, job->repeat.request_bytes);
  memcpy(job->repeat.reply, job->reply, REPLY_BYTES);
  return true;
}

void repeat_forget(struct job *job) {
  if (job->repeat.request_bytes > 0) {
    job->repeat.request_bytes = 0;
    profiles_return(&job->order);
  }
}

static bool radii_are_right(const struct job *job, const uint8_t *radii) {
  static const uint8_t zeros[WIRE_ALIGNMENT];
  const size_t bytes = (size_t)job->count * value_bytes(job);
  const core_fault fault =
      value_bytes(job) == sizeof(float)
          ? core_radii_check_f32((size_t)job->count, (const float *)(const void *)radii)
          : core_radii_check_f64((size_t)job->count, (const double *)(const void *)radii);
  return fault.field == NULL &&
         memcmp(radii + bytes, zeros, (size_t)wire_padded(bytes) - bytes) == 0;
}

bool repeat_matches(const struct job *job, const uint8_t *payload, size_t payload_bytes) {
  const struct job_repeat *repeat = &job->repeat;
  if (repeat->request_bytes == 0 || payload_bytes != repeat->payload_bytes ||
      memcmp(payload, repeat->request, repeat->request_bytes) != 0) {
    return false;
  }
  return payload_bytes == repeat->request_bytes ||
         radii_are_right(job, payload + repeat->request_bytes);
}

void repeat_answer(struct job *job, struct server *server, struct job_scratch *scratch,
                   const uint8_t *payload, uint8_t *reply) {
  const struct job_repeat *repeat = &job->repeat;
  const size_t n = (size_t)job->count;
  const size_t used = n * value_bytes(job);
  const void *radii = payload + repeat->request_bytes;
  if (repeat->payload_bytes == repeat->request_bytes) {
    job->first = job->index = 0;
    job_expand_grid(job, n, scratch->radii);
    radii = scratch->radii;
  }
  memcpy(reply, repeat->reply, REPLY_BYTES);
  uint8_t *to = reply + REPLY_BYTES;
  for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
    if (eval_is_array(job->request.fixed.wanted, quantity->id)) {
      batch_take(&scratch->batch, &server->stats, &job->order, quantity->id, n, radii, to);
      memset(to + used, 0, (size_t)job->layout.array_bytes - used);
      to += job->layout.array_bytes;
    }
  }
  stats_add(&server->stats, STATS_CACHE_HITS, 1);
  stats_add(&server->stats, STATS_RADII_EVALUATED, n);
  stats_add(&server->stats, STATS_SLICES_EVALUATED, 1);
}
