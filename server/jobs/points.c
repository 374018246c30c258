/* Points: takes a set of points in parts. The last part ends when the tree of the set has been built,
 * on a thread of the cache. */
#include "server/jobs/points.h"

#include <assert.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>

#include "server/jobs/job.h"

enum {
  ROWS_MIN = 4096,       /* room for this many points is taken first, and then twice as much */
  RETRY_AFTER_MS = 1000, /* retry_after_ms of BUSY: sets take seconds to send */
  BUILD_NS = 1000000000  /* ns for which one call builds a set's tree */
};

/* A thread of its own frees a larger set. Returning 8 MiB to the system takes less than a millisecond. */
#define FREED_AT_ONCE_BYTES ((uint64_t)8 << 20)

/* For each part of a set that is this large, its client has frame_timeout_ms. */
#define TIMED_BYTES ((uint64_t)16 << 20)

/* A set of points, complete or not. One thread adds points; references are counted, so that the
 * cache and a job can each hold one. */
struct points {
  struct server *server;
  _Atomic unsigned references;
  uint64_t set[2]; /* name of the set: the hash of its content */
  uint32_t channel_count;
  uint64_t count;    /* number of points of the whole set */
  uint64_t next;     /* number of points added so far */
  uint64_t capacity; /* number of points that fit into the arrays */
  double *xyz;       /* [next][GATHER_AXES] */
  float *power;      /* [next][channel_count] */
  gather_name name;  /* hash of the points added so far */
  uint64_t begun_ms; /* arrival of the first part, on the loop's clock, in ms */
};

/* Returns the memory that a point takes as it is sent. */
static uint64_t row_bytes(const struct points *points) {
  return GATHER_AXES * sizeof(double) + points->channel_count * sizeof(float);
}

/* Makes a set without points, with one reference. Returns NULL if there is no memory. */
static struct points *new_set(struct server *server, const wire_points_request *request,
                              uint64_t now_ms) {
  struct points *points = calloc(1, sizeof *points);
  if (points != NULL) {
    points->server = server;
    atomic_init(&points->references, 1);
    memcpy(points->set, request->set, sizeof points->set);
    points->channel_count = request->channel_count;
    points->count = request->point_count;
    points->begun_ms = now_ms;
    gather_name_start(&points->name, request->channel_count, request->point_count);
    stats_add(&server->stats, STATS_POINTS_SENT_SETS, 1);
  }
  return points;
}

/* Returns whether the request names this set, with the same counts. */
static bool is_set(const struct points *points, const wire_points_request *request) {
  return memcmp(points->set, request->set, sizeof points->set) == 0 &&
         points->channel_count == request->channel_count && points->count == request->point_count;
}

/* ---- memory ---------------------------------------------------------------------------------- */

static wire_error busy_error(void) {
  return wire_error_busy("points_bytes", "fewer points that are being sent at a time",
                         RETRY_AFTER_MS);
}

static bool take_bytes(struct server *server, uint64_t bytes) {
  if (atomic_fetch_add(&server->points_sent_bytes, bytes) + bytes <= server->options.points_bytes) {
    return true;
  }
  atomic_fetch_sub(&server->points_sent_bytes, bytes);
  return false;
}

/* Takes memory for n more points. */
static wire_error reserve_points(struct points *points, uint64_t n) {
  const uint64_t wanted = points->next + n;
  assert(wanted <= points->count);
  if (wanted <= points->capacity) {
    return wire_error_none();
  }
  uint64_t capacity = 2 * points->capacity > ROWS_MIN ? 2 * points->capacity : ROWS_MIN;
  capacity = capacity < wanted ? wanted : capacity;
  capacity = capacity > points->count ? points->count : capacity;
  const uint64_t more = (capacity - points->capacity) * row_bytes(points);
  if (!take_bytes(points->server, more)) {
    return busy_error();
  }
  double *xyz = realloc(points->xyz, (size_t)capacity * GATHER_AXES * sizeof *xyz);
  points->xyz = xyz != NULL ? xyz : points->xyz;
  float *power = realloc(points->power, (size_t)(capacity * points->channel_count) * sizeof *power);
  points->power = power != NULL ? power : points->power;
  if (xyz == NULL || power == NULL) {
    atomic_fetch_sub(&points->server->points_sent_bytes, more);
    return busy_error();
  }
  points->capacity = capacity;
  return wire_error_none();
}

bool points_is_late(const struct points *points, uint64_t now_ms) {
  const uint64_t pieces = 1 + points->count * row_bytes(points) / TIMED_BYTES;
  return now_ms - points->begun_ms > pieces * points->server->options.frame_timeout_ms;
}

/* ---- freeing --------------------------------------------------------------------------------- */

/* Calls destroy(what), which returns NULL, on a thread of its own if that takes long. */
static void free_aside(void *(*destroy)(void *what), void *what, uint64_t bytes) {
  pthread_t thread;
  if (bytes > FREED_AT_ONCE_BYTES && pthread_create(&thread, NULL, destroy, what) == 0) {
    pthread_detach(thread);
  } else {
    destroy(what);
  }
}

static void *destroy_points(void *what) {
  struct points *points = what;
  free(points->xyz);
  free(points->power);
  free(points);
  return NULL;
}

static void hold_set(struct points *points) {
  atomic_fetch_add_explicit(&points->references, 1, memory_order_relaxed);
}

void points_release(struct points *points) {
  if (points == NULL ||
      atomic_fetch_sub_explicit(&points->references, 1, memory_order_acq_rel) > 1) {
    return;
  }
  const uint64_t bytes = points->capacity * row_bytes(points);
  atomic_fetch_sub(&points->server->points_sent_bytes, bytes);
  stats_subtract(&points->server->stats, STATS_POINTS_SENT_SETS, 1);
  free_aside(destroy_points, points, bytes);
}

/* ---- adding ---------------------------------------------------------------------------------- */

/* Checks n points, for which there is memory, and adds them. */
static wire_error add_points(struct points *points, uint64_t n, const double *xyz,
                             const float *power) {
  const uint32_t channels = points->channel_count;
  assert(points->next + n <= points->capacity);
  const core_fault fault = core_gather_check_points((size_t)n, xyz, channels, power);
  if (fault.field != NULL) {
    return job_error_behind(fault, points->next);
  }
  gather_name_add(&points->name, n, xyz, power);
  memcpy(points->xyz + points->next * GATHER_AXES, xyz, (size_t)n * GATHER_AXES * sizeof *xyz);
  memcpy(points->power + points->next * channels, power, (size_t)(n * channels) * sizeof *power);
  points->next += n;
  return wire_error_none();
}

/* Returns whether the set, whose points are all there, has the hash that it is named by. */
static bool has_its_name(struct points *points) {
  uint64_t name[2];
  assert(points->next == points->count);
  gather_name_end(&points->name, name);
  return memcmp(name, points->set, sizeof name) == 0;
}

/* ---- sets in the cache ----------------------------------------------------------------------- */

/* Builds the tree of a set. */
static core_fault prepare(void *thing, const struct cache_key *key, const core_isa *isa,
                          const atomic_bool *stop) {
  const struct points *points = key->source;
  core_gather_points **tree = thing;
  (void)isa, (void)stop;
  *tree = core_gather_points_create((size_t)points->count, points->xyz, points->channel_count,
                                    points->power);
  while (*tree != NULL && !core_gather_points_build(*tree, BUILD_NS)) {
  }
  return *tree != NULL
             ? (core_fault){NULL, NULL, 0}
             : (core_fault){CORE_FIELD_MEMORY, "less than the memory that is free: try again", 0};
}

static uint64_t tree_bytes(const void *thing) {
  return core_gather_points_bytes(*(core_gather_points *const *)thing);
}

static void *destroy_tree(void *tree) {
  core_gather_points_free(tree);
  return NULL;
}

static void free_tree(void *thing) {
  free_aside(destroy_tree, *(core_gather_points **)thing, tree_bytes(thing));
}

static void hold(void *points) {
  hold_set(points);
}

static void release(void *points) {
  points_release(points);
}

static const struct cache_kind kind = {.thing_bytes = sizeof(core_gather_points *),
                                       .prepare = prepare,
                                       .free = free_tree,
                                       .bytes = tree_bytes,
                                       .hold = hold,
                                       .release = release,
                                       .apart = true};

enum lookup_state points_get(struct lookups *lookups, struct lookup *lookup, const uint64_t set[2],
                             struct points *points) {
  const struct cache_key key = {.kind = &kind,
                                .content = set,
                                .content_bytes = 2 * sizeof set[0],
                                .hash = set[0],
                                .source = points};
  return lookup_get(lookups, lookup, &key, CACHE_SLOW, false);
}

/* ---- the job --------------------------------------------------------------------------------- */

struct points_job {
  struct job job;
  points_request request;
  struct lookup lookup;
  struct points **sent;  /* the set that this connection is sending */
  struct points *points; /* the set that this part is of; a reference; NULL: none, or it is known */
  bool looked_up;        /* whether the cache has been tried for the set */
  bool complete;         /* whether this part is the last one, and its points have been added */
  uint64_t done;         /* number of this part's points that have been added */
};

JOB_STRUCTURE(struct points_job, points_of)

/* What a number of a point costs, in radii of a dipole: to check, to hash and to copy it. */
enum { NUMBER_RADII = 10 };

static uint64_t row_radii(const struct points_job *points) {
  return (GATHER_AXES + (uint64_t)points->request.fixed.channel_count) * NUMBER_RADII;
}

static enum job_outcome start_points(struct job *job, const struct job_request *from) {
  struct points_job *points = points_of(job);
  const wire_points_request *fixed = &points->request.fixed;
  const uint64_t most = job->context->server->options.max_points;
  assert(from->points != NULL);
  if (!job_passes(job, points_request_parse(from->payload, &from->layout, &points->request))) {
    return JOB_REFUSED;
  }
  if (fixed->point_count > most) {
    return job_refuse(job, job_too_large("point_count", most, "points"));
  }
  const double radii = (double)fixed->part_points * (double)row_radii(points);
  if (!job_passes(job, job_admit(job, radii, "part_points"))) {
    return JOB_REFUSED;
  }
  points->sent = from->points;
  points->points = NULL;
  points->looked_up = points->complete = false;
  points->done = 0;
  job_init_other(job, &points->lookup, from);
  return JOB_GOES_ON;
}

/* ---- steps ----------------------------------------------------------------------------------- */

static enum job_outcome reply_with(struct points_job *points, bool known) {
  const wire_points_request *fixed = &points->request.fixed;
  const wire_points_reply reply = {.set = {fixed->set[0], fixed->set[1]},
                                   .known = known,
                                   .point_next = known                    ? fixed->point_count
                                                 : points->points != NULL ? points->points->next
                                                                          : 0};
  return job_reply(&points->job, &reply);
}

/* Drops the set that this connection is sending. */
static void drop_sent(struct points_job *points) {
  points_release(*points->sent);
  *points->sent = NULL;
}

static enum job_outcome refuse_set(struct points_job *points, wire_error error) {
  drop_sent(points);
  return job_refuse(&points->job, error);
}

/* Finds the set that the part belongs to, or begins it, and takes memory for the part. */
static enum job_outcome begin_set(struct points_job *points) {
  const wire_points_request *fixed = &points->request.fixed;
  struct job_context *context = points->job.context;
  if (*points->sent != NULL && fixed->point_first == 0 && fixed->part_points > 0) {
    drop_sent(points); /* part 0 begins the set again */
  }
  if (*points->sent == NULL && fixed->point_first == 0 && fixed->part_points > 0) {
    *points->sent = new_set(context->server, fixed, uv_now(context->loop));
    if (*points->sent == NULL) {
      return job_refuse(&points->job, job_busy());
    }
  }
  if (*points->sent == NULL || !is_set(*points->sent, fixed)) {
    return fixed->part_points == 0
               ? reply_with(points, false)
               : job_refuse(&points->job,
                            wire_error_make(WIRE_STATUS_UNKNOWN_POINTS, "point_first",
                                            "0: the points before it have not been sent here"));
  }
  points->points = *points->sent;
  hold_set(points->points);
  if (fixed->part_points == 0) {
    return reply_with(points, false);
  }
  if (fixed->point_first != points->points->next) {
    return refuse_set(points,
                      wire_error_make(WIRE_STATUS_BAD_VALUE, "point_first",
                                      "the position behind the points that have been sent"));
  }
  const wire_error error = reserve_points(points->points, fixed->part_points);
  return error.status == WIRE_STATUS_OK ? JOB_GOES_ON : refuse_set(points, error);
}

/* Looks the set up, whose tree the cache builds. */
static enum job_outcome look_set_up(struct points_job *points) {
  const uint64_t *set = points->request.fixed.set;
  switch (points_get(&points->job.context->profiles.lookups, &points->lookup, set,
                     points->complete ? points->points : NULL)) {
  case LOOKUP_READY:
    if (*points->sent != NULL && is_set(*points->sent, &points->request.fixed)) {
      drop_sent(points);
    }
    return reply_with(points, true);
  case LOOKUP_WAIT:
    return JOB_WAITS;
  case LOOKUP_FAULT:
    if (!lookup_is_unknown(points->lookup.fault)) {
      return refuse_set(points, job_fault(points->lookup.fault, 0));
    }
  }
  points->looked_up = true;
  return begin_set(points);
}

static enum job_outcome add_slice(struct points_job *points, uint64_t *spent) {
  const wire_points_request *fixed = &points->request.fixed;
  const uint64_t left = fixed->part_points - points->done;
  const uint64_t most = JOB_SLICE_RADII / row_radii(points);
  const uint64_t n = left < most ? left : most;
  const wire_error error =
      add_points(points->points, n, points->request.xyz + points->done * GATHER_AXES,
                 points->request.power + points->done * fixed->channel_count);
  *spent += n * row_radii(points);
  job_pay(&points->job, n * row_radii(points));
  points->done += n;
  if (error.status != WIRE_STATUS_OK) {
    return refuse_set(points, error);
  }
  if (points->done < fixed->part_points) {
    return JOB_GOES_ON;
  }
  if (points->points->next < points->points->count) {
    return reply_with(points, false);
  }
  if (!has_its_name(points->points)) {
    return refuse_set(points, wire_error_make(WIRE_STATUS_BAD_VALUE, "set",
                                              "the hash of the counts and points (G2)"));
  }
  points->complete = true;
  return JOB_GOES_ON;
}

static enum job_outcome step_points(struct job *job, uint64_t *budget) {
  struct points_job *points = points_of(job);
  uint64_t spent = JOB_STEP_RADII;
  const enum job_outcome outcome =
      !points->looked_up || points->complete ? look_set_up(points) : add_slice(points, &spent);
  *budget -= spent < *budget ? spent : *budget;
  return outcome;
}

static void end_points(struct job *job) {
  struct points_job *points = points_of(job);
  lookup_return(&points->lookup);
  points_release(points->points);
}

const struct job_kind job_kind_POINTS = {.request = &schema_points_request,
                                         .reply = &schema_points_reply,
                                         .start = start_points,
                                         .step = step_points,
                                         .end = end_points};
