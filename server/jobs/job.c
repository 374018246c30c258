#include "server/jobs/job.h"

#include <assert.h>
#include <stdio.h>
#include <string.h>

/* ---- starting and ending --------------------------------------------------------------------- */

const struct job_type *job_type_of(unsigned type) {
  static const struct job_type types[] = {
#define WIRE_MESSAGE(type, IDENT, name, ROLE, LATENCY, ...)                                        \
  [type] = {&job_kind_##IDENT, ROLE_##ROLE, LATENCY_##LATENCY, STATS_REQUESTS_##IDENT},
#include "proto/messages.def"
  };
  const size_t count = sizeof types / sizeof types[0];
  return type < count && types[type].kind != NULL ? &types[type] : NULL;
}

enum job_outcome job_start(struct job_slot *slot, struct job_request *request) {
  struct job *job = (struct job *)(void *)slot->bytes;
  if (request->type == NULL) {
    return job_refuse(job,
                      wire_error_make(WIRE_STATUS_BAD_TYPE, "type", "a message of the protocol"));
  }
  job->kind = request->type->kind;
  job->latency = request->type->latency;
  job->context = request->context;
  job->header = *request->header;
  job->payload = request->payload;
  job->owed_radii = 0;
  job->rests = false;
  job->large = false;
  job->owner = request->profiles;
  job->reader_idle = true;
  return job->kind->request == NULL ||
                 job_passes(job, schema_check(job->kind->request, request->payload,
                                              request->header->payload_bytes, &request->layout))
             ? job->kind->start(job, request)
             : JOB_REFUSED;
}

void job_end(struct job *job) {
  job_pay(job, job->owed_radii);
  if (job->large) {
    LIST_REMOVE(job, in_large);
  }
  if (job->kind->end != NULL) {
    job->kind->end(job);
  }
}

void job_init_other(struct job *job, struct lookup *lookup, const struct job_request *request) {
  lookup->on_ready = request->on_ready;
  lookup->context = request->owner;
  lookup->owner = &job->owner;
  lookup->entry = NULL;
  lookup->awaited = NULL;
  lookup->admitted = false;
  lookup->woken = false;
}

void job_init_lookup(struct job *job, struct profiles_lookup *lookup,
                     const struct job_request *request) {
  job_init_other(job, &lookup->cached, request);
  lookup->ready = false;
  lookup->place = (struct profiles_place){0};
}

/* ---- admission control ----------------------------------------------------------------------- */

/* About how long one radius of a dipole takes on a slow machine. */
#define RADIUS_NS 2

/* A limit for the radii that one job owes. Sums of such numbers are exact in double precision. */
#define OWED_MOST_RADII 1e15

static uint64_t least(uint64_t a, uint64_t b) {
  return a < b ? a : b;
}

/* Returns the most radii by which the running large jobs delay a new job of this many radii. */
static uint64_t delay_radii(const struct job_context *context, uint64_t radii, uint64_t max_radii) {
  const uint64_t each = least(radii, max_radii / JOB_BACKLOG_SHARES);
  uint64_t sum = 0;
  const struct job *other;
  LIST_FOREACH(other, &context->large, in_large) {
    sum += other->rests ? 0 : least(other->owed_radii, each);
  }
  return sum;
}

static wire_error admit_large(struct job *job, uint64_t radii, const char *field) {
  struct job_context *context = job->context;
  const uint64_t max_radii = context->server->options.max_backlog_ms * 1000000 / RADIUS_NS;
  const uint64_t delay = delay_radii(context, radii, max_radii);
  if (delay >= max_radii) {
    return wire_error_busy(field,
                           "fewer, or later: others' work would delay it by max_backlog_ms or more",
                           (uint32_t)least(delay * RADIUS_NS / 1000000, 60000));
  }
  job->large = true;
  LIST_INSERT_HEAD(&context->large, job, in_large);
  return wire_error_none();
}

wire_error job_admit(struct job *job, double radii, const char *field) {
  const uint64_t owed = (uint64_t)(radii < OWED_MOST_RADII ? radii : OWED_MOST_RADII);
  if (owed > JOB_SLICE_RADII) {
    const wire_error error = admit_large(job, owed, field);
    if (error.status != WIRE_STATUS_OK) {
      return error;
    }
  }
  job->owed_radii = owed;
  job->context->owed_radii += owed;
  return wire_error_none();
}

void job_pay(struct job *job, uint64_t radii) {
  const uint64_t paid = radii < job->owed_radii ? radii : job->owed_radii;
  job->owed_radii -= paid;
  job->context->owed_radii -= job->rests ? 0 : paid;
}

void job_rest(struct job *job) {
  job->context->owed_radii -= job->rests ? 0 : job->owed_radii;
  job->rests = true;
}

void job_resume(struct job *job) {
  job->context->owed_radii += job->rests ? job->owed_radii : 0;
  job->rests = false;
}

/* ---- refusals -------------------------------------------------------------------------------- */

enum job_outcome job_refuse(struct job *job, wire_error refusal) {
  job->refusal = refusal;
  return JOB_REFUSED;
}

bool job_passes(struct job *job, wire_error error) {
  if (error.status != WIRE_STATUS_OK) {
    job->refusal = error;
  }
  return error.status == WIRE_STATUS_OK;
}

enum job_outcome job_check(struct job *job, wire_error error) {
  return job_passes(job, error) ? JOB_GOES_ON : JOB_REFUSED;
}

enum job_outcome job_follow(struct job *job, enum lookup_state state, const core_fault *fault,
                            uint64_t channel) {
  return state == LOOKUP_READY  ? JOB_GOES_ON
         : state == LOOKUP_WAIT ? JOB_WAITS
                                : job_refuse(job, job_fault(*fault, channel));
}

enum job_outcome job_get(struct job *job, struct lookup *lookup, const struct cache_kind *kind,
                         const void *content, size_t bytes, enum cache_pace pace) {
  const struct cache_key key = {.kind = kind,
                                .content = content,
                                .content_bytes = bytes,
                                .hash = cache_hash(0, content, bytes)};
  const enum lookup_state state =
      lookup_get(&job->context->profiles.lookups, lookup, &key, pace, true);
  return job_follow(job, state, &lookup->fault, lookup->fault.index);
}

wire_error job_error(core_fault fault) {
  if (fault.field == NULL) {
    return wire_error_none();
  }
  wire_error error = wire_error_make(WIRE_STATUS_BAD_VALUE, fault.field, fault.allowed);
  error.index = fault.index;
  return error;
}

wire_error job_error_behind(core_fault fault, uint64_t first) {
  fault.index += (size_t)first;
  return job_error(fault);
}

wire_error job_fault(core_fault fault, uint64_t channel) {
  fault.index = channel;
  wire_error error = job_error(fault);
  if (lookup_is_busy(fault)) {
    error.status = WIRE_STATUS_BUSY;
    error.retry_after_ms = JOB_RETRY_AFTER_MS;
  } else if (lookup_is_unknown(fault)) {
    error.status = WIRE_STATUS_UNKNOWN_POINTS;
  }
  return error;
}

wire_error job_no_memory(void) {
  return job_fault(
      (core_fault){CORE_FIELD_MEMORY, "less than the memory that is free: try again", 0}, 0);
}

wire_error job_busy(void) {
  return wire_error_busy("max_total_bytes",
                         "fewer bytes at a time in the buffers of all connections",
                         JOB_RETRY_AFTER_MS);
}

wire_error job_check_count(const struct job *job, uint64_t medium_count) {
  const uint64_t most = job->context->server->options.max_media;
  return medium_count > most ? job_too_large("medium_count", most, "media") : wire_error_none();
}

wire_error job_too_large(const char *field, uint64_t most, const char *what) {
  char allowed[80];
  snprintf(allowed, sizeof allowed, "at most %llu %s", (unsigned long long)most, what);
  return wire_error_make(WIRE_STATUS_TOO_LARGE, field, allowed);
}

/* ---- replies ----------------------------------------------------------------------------------- */

enum job_outcome job_reply(struct job *job, const void *head) {
  const schema_payload *reply = job->kind->reply;
  assert(reply->fixed_bytes <= sizeof job->head);
  memcpy(job->head, head, reply->fixed_bytes);
  job->part_bytes = schema_bytes(reply, head);
  if (job->part_bytes <= job->context->server->options.max_frame_bytes) {
    return JOB_NEXT_PART;
  }
  const char *count = reply->parts[0].count[0].name;
  return schema_field_of(job->kind->request, count) == NULL
             ? JOB_NEXT_PART /* the daemon's own lists have no limit */
             : job_refuse(job, wire_error_make(WIRE_STATUS_TOO_LARGE, count,
                                               "fewer: this reply exceeds max_frame_bytes"));
}

void job_put_reply(struct job *job, uint8_t *payload) {
  const struct job_kind *kind = job->kind;
  memcpy(payload, job->head, kind->reply->fixed_bytes);
  if (kind->put != NULL) {
    kind->put(job, payload + kind->reply->fixed_bytes);
  }
}

void job_parts_cut(struct job_parts *parts, uint64_t total, uint64_t most) {
  assert(most > 0 || total == 0);
  const uint64_t count = total < most ? total : most;
  *parts = (struct job_parts){
      .most = most,
      .count = count,
      .left = total - count,
      .part_count = total > 0 ? (uint32_t)((total - 1) / most + 1) : 1,
  };
}

bool job_parts_next(struct job_parts *parts) {
  if (parts->part + 1 == parts->part_count) {
    return false;
  }
  parts->first += parts->count;
  parts->count = parts->left < parts->most ? parts->left : parts->most;
  parts->left -= parts->count;
  parts->part++;
  return true;
}

bool job_parts_fit(struct job *job, const schema_payload *reply, const void *start, unsigned unit,
                   uint64_t total) {
  const struct options *options = &job->context->server->options;
  uint64_t most = total;
  if (schema_part_bytes(reply, start, total) > options->max_frame_bytes) {
    most = schema_part_values(reply, start, unit, options->max_part_bytes);
    if (most == 0) {
      return false;
    }
  }
  job_parts_cut(&job->parts, total, most);
  job->part_bytes = schema_part_bytes(reply, start, job->parts.count);
  return true;
}

enum job_outcome job_part_begin(struct job *job, uint8_t *payload) {
  job->parts.payload = payload;
  job->parts.index = 0;
  return JOB_GOES_ON;
}

enum job_outcome job_part_run(struct job *job, uint64_t *budget, uint64_t radii,
                              enum stats_index done,
                              enum job_outcome (*next)(struct job *job, uint64_t *spent)) {
  uint64_t spent = JOB_STEP_RADII;
  const uint64_t begun = job->parts.index;
  enum job_outcome outcome = JOB_GOES_ON;
  while (outcome == JOB_GOES_ON && !job_part_is_done(job) && spent < JOB_SLICE_RADII) {
    outcome = next(job, &spent);
  }
  stats_add(&job->context->server->stats, done, job->parts.index - begun);
  job_pay(job, (job->parts.index - begun) * radii);
  *budget -= spent < *budget ? spent : *budget;
  return outcome;
}

enum job_outcome job_part_end(struct job *job, const schema_payload *reply, const void *start) {
  struct job_parts *parts = &job->parts;
  const wire_part head = {parts->part, parts->part_count, parts->first, parts->count};
  memmove(parts->payload, start, reply->fixed_bytes); /* it may be written already */
  wire_put_part(parts->payload, &head);
  if (!job_parts_next(parts)) {
    return JOB_DONE;
  }
  job->part_bytes = schema_part_bytes(reply, start, parts->count);
  return JOB_NEXT_PART;
}
