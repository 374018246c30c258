/* Gather: sums the light of a set of points at many positions, slice by slice. */
#include "core/gather/gather.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/ruler.h"
#include "proto/gather.h"
#include "server/jobs/job.h"
#include "server/jobs/points.h"

/* The memory of a job besides its slot, one block. */
struct gather_work {
  struct lookup set;
  struct profiles_lookup channels[CORE_GATHER_CHANNELS_MAX];
  struct profiles_lookup ruler; /* transport for the next channel, if its model error needs it */
  double model_error[CORE_GATHER_CHANNELS_MAX];
  uint32_t ready; /* number of channels whose profiles are ready */
  core_gather_sum *sum;
  core_gather_scratch *scratch;
  core_gather_visits visits; /* counts of the current part */
  float worst;               /* the largest bound of the current part */
  double cost;               /* cost of the queries counted so far, in evaluations of a dipole */
  double done_radii;         /* work done on a query that takes several parts */
  uint32_t order[GATHER_PART_QUERIES]; /* of the current part, or of those that are being counted */
  float bounds[GATHER_PART_QUERIES * CORE_GATHER_CHANNELS_MAX];
  double sums[GATHER_PART_QUERIES * CORE_GATHER_CHANNELS_MAX]; /* sums of the current part */
};

struct gather_job {
  struct job job;
  gather_request request;
  struct gather_work *work;
  uint64_t bytes;       /* of work and its scratch, as counted in the server's budget */
  uint64_t checked;     /* number of queries whose values have been checked */
  uint64_t counted;     /* number of queries whose cost has been counted */
  uint64_t query_radii; /* the mean cost of a query, in radii of a dipole; 0 until it is known */
  bool whole;           /* whether parts are not cut by the time that they take */
  uint32_t piece;       /* of the part, if it is one query that takes long, from 0 */
  uint32_t piece_count; /* each a part of the reply, of which the last has the sum; else 1 */
  uint64_t index;       /* index of the next query in the part's order */
};

JOB_STRUCTURE(struct gather_job, gather_of)

/* What a part takes at most: a quarter of a second, as far as the cost of a query is known before. */
#define PART_RADII (UINT64_C(1) << 27)

/* The cost of this many queries is counted, at most; that of others is taken to be the same. */
enum { COUNTED_MOST = 4 * GATHER_PART_QUERIES, COUNTED_AT_ONCE = 1024 };

static struct gather_work *new_work(struct gather_job *gather, const struct job_request *from) {
  struct gather_work *work = malloc(sizeof *work);
  if (work == NULL) {
    return NULL;
  }
  work->ready = 0;
  work->cost = 0;
  work->sum = NULL;
  work->scratch = NULL;
  job_init_other(&gather->job, &work->set, from);
  job_init_lookup(&gather->job, &work->ruler, from);
  for (uint32_t i = 0; i < CORE_GATHER_CHANNELS_MAX; i++) {
    job_init_lookup(&gather->job, &work->channels[i], from);
  }
  return work;
}

/* ---- checking -------------------------------------------------------------------------------- */

static wire_error check_media(const struct gather_job *gather) {
  const gather_request *request = &gather->request;
  const wire_gather_request *fixed = &request->fixed;
  wire_error error = job_check_count(&gather->job, fixed->medium_count);
  for (uint32_t i = 0; error.status == WIRE_STATUS_OK && i < fixed->medium_count; i++) {
    const size_t first = (size_t)i * fixed->layer_count;
    error = job_error_behind(core_profile_check(fixed->model, fixed->moments, fixed->evaluator,
                                                &request->media[first], &request->parameters, NULL),
                             first);
  }
  return error;
}

static enum job_outcome start_gather(struct job *job, const struct job_request *from) {
  struct gather_job *gather = gather_of(job);
  if (!job_passes(job, gather_request_parse(from->payload, &from->layout, &gather->request)) ||
      !job_passes(job, check_media(gather))) {
    return JOB_REFUSED;
  }
  gather->request.parameters.value[CORE_PARAMETER_MHZ] = (double)NAN; /* it sums R alone */
  if (!budget_take(job->context->buffers, sizeof *gather->work)) {
    return job_refuse(job, job_busy());
  }
  gather->bytes = sizeof *gather->work;
  gather->work = new_work(gather, from);
  if (gather->work == NULL) {
    budget_return(job->context->buffers, gather->bytes);
    return job_refuse(job, job_busy());
  }
  gather->checked = 0;
  gather->counted = 0;
  gather->query_radii = 0;
  gather->whole = from->whole;
  return JOB_GOES_ON;
}

/* Checks the next queries. */
static enum job_outcome check_queries(struct gather_job *gather) {
  const gather_request *request = &gather->request;
  const uint64_t left = request->fixed.query_count - gather->checked;
  const size_t n = (size_t)(left < GATHER_PART_QUERIES ? left : GATHER_PART_QUERIES);
  core_fault fault = core_gather_check_queries(n, request->queries + gather->checked * GATHER_AXES);
  if (fault.field != NULL) {
    fault.index += (size_t)gather->checked;
    return job_refuse(&gather->job, job_error(fault));
  }
  gather->checked += n;
  return JOB_GOES_ON;
}

/* ---- preparing ------------------------------------------------------------------------------- */

static enum job_outcome find_set(struct gather_job *gather) {
  struct lookup *lookup = &gather->work->set;
  const wire_gather_request *fixed = &gather->request.fixed;
  const enum lookup_state state =
      points_get(&gather->job.context->profiles.lookups, lookup, fixed->set, NULL);
  if (state != LOOKUP_READY) {
    return job_follow(&gather->job, state, &lookup->fault, 0);
  }
  return core_gather_points_channels(points_found(lookup)) == fixed->medium_count
             ? JOB_GOES_ON
             : job_refuse(&gather->job,
                          wire_error_make(WIRE_STATUS_BAD_COUNT, "medium_count",
                                          "as many as the points of the set have powers"));
}

static enum job_outcome prepare_channel(struct gather_job *gather) {
  struct gather_work *work = gather->work;
  const wire_gather_request *fixed = &gather->request.fixed;
  const core_medium *medium = &gather->request.media[work->ready * fixed->layer_count];
  struct profiles_lookup *lookup = &work->channels[work->ready];
  struct profiles *profiles = &gather->job.context->profiles;
  enum lookup_state state = profiles_get_ruler(profiles, &work->ruler, fixed->model,
                                               &gather->request.parameters, medium, false);
  if (state == LOOKUP_READY) {
    profiles_start(lookup, fixed->model, fixed->moments, fixed->evaluator,
                   &gather->request.parameters);
    state = profiles_get(profiles, lookup, medium);
  } else {
    lookup->fault = work->ruler.fault;
  }
  if (state == LOOKUP_READY) {
    const core_model_errors errors = core_model_errors_measure(
        &lookup->profile, work->ruler.ready ? &work->ruler.profile : NULL);
    work->model_error[work->ready++] = core_gather_model_error(&errors, medium);
    profiles_return(&work->ruler);
  }
  return job_follow(&gather->job, state, &lookup->fault, work->ready);
}

/* Takes memory for the scratch, which points of this number need. */
static wire_error open_scratch(struct gather_job *gather) {
  struct gather_work *work = gather->work;
  const uint64_t bytes = core_gather_scratch_bytes();
  if (!budget_take(gather->job.context->buffers, bytes)) {
    return job_busy();
  }
  gather->bytes += bytes;
  work->scratch = core_gather_scratch_create(work->sum, points_found(&work->set));
  return work->scratch != NULL ? wire_error_none() : job_busy();
}

static wire_error admit_queries(struct gather_job *gather) {
  const struct gather_work *work = gather->work;
  const double counted = (double)gather->counted;
  const double cost = counted > 0 ? work->cost / counted : 1;
  gather->query_radii = (uint64_t)fmax(cost, 1);
  return job_admit(&gather->job, (double)gather->request.fixed.query_count * cost, "query_count");
}

/* Cuts the reply into parts, which also tell the client how far the sums have come: none takes much
 * longer than a second of a core, so that no client thinks that the daemon hangs. A query that takes
 * longer by itself has parts without a sum before its own. */
static void cut_reply(struct gather_job *gather) {
  const wire_gather_request *fixed = &gather->request.fixed;
  const uint64_t head_bytes = gather_sums_offset(fixed->medium_count);
  const uint64_t part_bytes = gather->job.context->server->options.max_part_bytes;
  assert(part_bytes >= head_bytes + CORE_GATHER_CHANNELS_MAX * sizeof(double)); /* options.def */
  uint64_t most = (part_bytes - head_bytes) / (fixed->medium_count * sizeof(double));
  const uint64_t in_time = gather->whole ? UINT64_MAX : PART_RADII / gather->query_radii;
  most = most < GATHER_PART_QUERIES ? most : GATHER_PART_QUERIES;
  most = most <= in_time ? most : in_time > 0 ? in_time : 1;
  job_parts_cut(&gather->job.parts, fixed->query_count, most);
  const uint64_t pieces = 1 + gather->query_radii / PART_RADII;
  const uint64_t pieces_most = UINT32_MAX / gather->job.parts.part_count;
  gather->piece = 0;
  gather->piece_count = (uint32_t)(most > 1 || gather->whole ? 1
                                   : pieces < pieces_most    ? pieces
                                                             : pieces_most);
}

/* Prepares the sum, when all profiles are there. */
static enum job_outcome prepare_sum(struct gather_job *gather) {
  struct gather_work *work = gather->work;
  const core_profile *profiles[CORE_GATHER_CHANNELS_MAX];
  for (uint32_t i = 0; i < work->ready; i++) {
    profiles[i] = &work->channels[i].profile;
  }
  const core_fault fault =
      core_gather_sum_prepare(&work->sum, gather->job.context->server->isa, work->ready, profiles,
                              gather->request.fixed.tolerance);
  wire_error error = fault.field == NULL ? open_scratch(gather) : job_fault(fault, 0);
  return job_check(&gather->job, error);
}

/* Counts what the next queries cost in the order in which a part takes them. */
static void count_cost(struct gather_job *gather) {
  struct gather_work *work = gather->work;
  const uint64_t into = gather->counted % GATHER_PART_QUERIES;
  const uint64_t block = gather->counted - into;
  const uint64_t rest = gather->request.fixed.query_count - block;
  const uint64_t n = rest < GATHER_PART_QUERIES ? rest : GATHER_PART_QUERIES;
  const double *queries = gather->request.queries + block * GATHER_AXES;
  if (into == 0) {
    core_gather_order(points_found(&work->set), (size_t)n, queries, work->order);
  }
  const uint64_t count = n - into < COUNTED_AT_ONCE ? n - into : COUNTED_AT_ONCE;
  work->cost += core_gather_cost(work->sum, points_found(&work->set), (size_t)count,
                                 work->order + into, queries);
  gather->counted += count;
}

/* Returns how many queries the present part holds. */
static uint64_t computed_count(const struct gather_job *gather) {
  return gather->piece + 1 == gather->piece_count ? gather->job.parts.count : 0;
}

static const double *queries_of(const struct gather_job *gather) {
  return gather->request.queries + gather->job.parts.first * GATHER_AXES;
}

/* Begins a part. */
static void begin_sums(struct gather_job *gather) {
  struct gather_work *work = gather->work;
  work->visits = (core_gather_visits){0};
  work->worst = 0;
  if (gather->piece == 0) {
    gather->index = 0;
    work->done_radii = 0;
    core_gather_order(points_found(&work->set), (size_t)gather->job.parts.count, queries_of(gather),
                      work->order);
  }
}

/* Begins the first part. The cost of the job is known. */
static enum job_outcome begin_first(struct gather_job *gather) {
  if (!job_passes(&gather->job, admit_queries(gather))) {
    return JOB_REFUSED;
  }
  cut_reply(gather);
  begin_sums(gather);
  return JOB_GOES_ON;
}

/* Counts the cost of further queries, or begins the first part. */
static enum job_outcome count_or_begin(struct gather_job *gather) {
  const uint64_t n = gather->request.fixed.query_count;
  if (gather->counted == (n < COUNTED_MOST ? n : COUNTED_MOST)) {
    return begin_first(gather);
  }
  count_cost(gather);
  return JOB_GOES_ON;
}

/* Does the next step of preparation. */
static enum job_outcome prepare_next(struct gather_job *gather) {
  const struct gather_work *work = gather->work;
  const wire_gather_request *fixed = &gather->request.fixed;
  return gather->checked < fixed->query_count ? check_queries(gather)
         : points_found(&work->set) == NULL   ? find_set(gather)
         : work->ready < fixed->medium_count  ? prepare_channel(gather)
         : work->sum == NULL                  ? prepare_sum(gather)
                                              : count_or_begin(gather);
}

/* ---- parts ----------------------------------------------------------------------------------- */

static void put_head(const struct gather_job *gather, uint8_t *payload) {
  const struct gather_work *work = gather->work;
  const wire_gather_request *requested = &gather->request.fixed;
  const struct job_parts *parts = &gather->job.parts;
  wire_gather_reply fixed = {.model = requested->model,
                             .evaluator = requested->evaluator,
                             .moments = requested->moments,
                             .channel_count = requested->medium_count,
                             .count = computed_count(gather),
                             .first = parts->first,
                             .part = parts->part * gather->piece_count + gather->piece,
                             .part_count = parts->part_count * gather->piece_count,
                             .bound = (double)work->worst,
                             .points_visited = work->visits.points,
                             .nodes_visited = work->visits.nodes};
  for (uint32_t i = 0; i < requested->medium_count; i++) {
    const core_profile *profile = &work->channels[i].profile;
    const wire_quantity_error error = {
        .numerical_error = core_gather_error(work->sum, points_found(&work->set), i, &work->visits),
        .model_error = work->model_error[i]};
    fixed.notes |= profile->notes;
    wire_put_quantity_error(
        payload + WIRE_BYTES_gather_reply + i * (size_t)WIRE_BYTES_quantity_error, &error);
  }
  wire_put_gather_reply(payload, &fixed);
}

/* Writes a part whose sums are known, and begins the next one. */
static enum job_outcome put_gather(struct job *job, uint8_t *payload) {
  struct gather_job *gather = gather_of(job);
  const uint32_t channels = gather->request.fixed.medium_count;
  put_head(gather, payload);
  memcpy(payload + gather_sums_offset(channels), gather->work->sums,
         (size_t)computed_count(gather) * channels * sizeof(double));
  gather->piece++;
  if (gather->piece == gather->piece_count) {
    gather->piece = 0;
    if (!job_parts_next(&gather->job.parts)) {
      return JOB_DONE;
    }
  }
  begin_sums(gather);
  return JOB_GOES_ON;
}

/* Records the largest bound of a slice. */
static void note_bounds(struct gather_work *work, const uint32_t *order, size_t n,
                        uint32_t channels) {
  for (size_t i = 0; i < n * channels; i++) {
    const float bound = work->bounds[order[i / channels] * (size_t)channels + i % channels];
    work->worst = bound > work->worst ? bound : work->worst;
  }
}

/* Returns whether the present part is complete: the last one of a query when its sum is known, the
 * ones before it when as much has been done as they stand for. */
static bool part_is_done(const struct gather_job *gather) {
  const bool known = gather->index == gather->job.parts.count;
  const double until = ((double)gather->piece + 1) * (double)PART_RADII;
  return known || (gather->piece + 1 < gather->piece_count && gather->work->done_radii >= until);
}

static enum job_outcome gather_slice(struct gather_job *gather, uint64_t *budget) {
  struct gather_work *work = gather->work;
  const uint32_t channels = gather->request.fixed.medium_count;
  const uint32_t *order = work->order + gather->index;
  const double slice = (double)(*budget < JOB_SLICE_RADII ? *budget : JOB_SLICE_RADII);
  double left = slice;
  const size_t n =
      core_gather_on(work->sum, points_found(&work->set), work->scratch,
                     (size_t)(gather->job.parts.count - gather->index), order, queries_of(gather),
                     work->sums, work->bounds, &work->visits, &left);
  note_bounds(work, order, n, channels);
  gather->index += n;
  const double radii = slice - left;
  const uint64_t spent = (uint64_t)fmax(radii, 1);
  work->done_radii += radii;
  job_pay(&gather->job, spent);
  *budget -= spent < *budget ? spent : *budget;
  struct stats *stats = &gather->job.context->server->stats;
  stats_add(stats, STATS_QUERIES_GATHERED, n * channels);
  if (!part_is_done(gather)) {
    return JOB_GOES_ON;
  }
  gather->job.part_bytes = gather_reply_bytes(channels, computed_count(gather));
  return JOB_NEXT_PART;
}

static enum job_outcome step_gather(struct job *job, uint64_t *budget) {
  struct gather_job *gather = gather_of(job);
  if (gather->query_radii > 0) {
    return gather_slice(gather, budget);
  }
  const uint64_t spent = gather->work->sum == NULL ? JOB_STEP_RADII : JOB_SLICE_RADII;
  *budget -= spent < *budget ? spent : *budget;
  return prepare_next(gather);
}

static void end_gather(struct job *job) {
  struct gather_job *gather = gather_of(job);
  struct gather_work *work = gather->work;
  core_gather_sum_free(work->sum);
  core_gather_scratch_free(work->scratch);
  for (uint32_t i = 0; i < CORE_GATHER_CHANNELS_MAX; i++) {
    profiles_return(&work->channels[i]);
  }
  lookup_return(&work->set);
  profiles_return(&work->ruler);
  free(work);
  budget_return(job->context->buffers, gather->bytes);
}

const struct job_kind job_kind_GATHER = {.request = &schema_gather_request,
                                         .detached = true,
                                         .start = start_gather,
                                         .begin_part = put_gather,
                                         .step = step_gather,
                                         .end = end_gather};
