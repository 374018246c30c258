/* Points: takes a set of points in parts (server/store/points.h). The last part ends when the
 * tree of the set has been built, on a thread of the pool. */
#include "server/store/points.h"

#include <assert.h>

#include "server/jobs/job.h"

struct points_job {
  struct job job;
  points_request request;
  struct lookup lookup;
  struct points **sent;  /* the set that this connection is sending */
  struct points *points; /* the set that this part is of; a reference; NULL: none, or it is known */
  bool looked_up;        /* whether the cache has been tried for the set */
  bool complete;         /* whether this part is the last one, and its points have been added */
  uint64_t done;         /* number of this part's points that have been added */
  wire_points_reply reply;
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
  wire_error error =
      points_request_parse(from->payload, from->header->payload_bytes, &points->request);
  if (error.status == WIRE_STATUS_OK && fixed->point_count > most) {
    error = job_too_large("point_count", most, "points");
  }
  if (error.status == WIRE_STATUS_OK) {
    error = job_admit(job, (double)fixed->part_points * (double)row_radii(points), "part_points");
  }
  if (error.status != WIRE_STATUS_OK) {
    return job_refuse(job, error);
  }
  points->sent = from->points;
  points->points = NULL;
  points->looked_up = points->complete = false;
  points->done = 0;
  points->reply = (wire_points_reply){.set = {fixed->set[0], fixed->set[1]}};
  job_init_other(job, &points->lookup, from);
  job->lookup = NULL;
  return JOB_GOES_ON;
}

/* ---- steps ----------------------------------------------------------------------------------- */

static enum job_outcome reply_with(struct points_job *points, bool known) {
  points->reply.known = known;
  points->reply.point_next = known                    ? points->request.fixed.point_count
                             : points->points != NULL ? points->points->next
                                                      : 0;
  points->job.part_bytes = WIRE_BYTES_points_reply;
  return JOB_NEXT_PART;
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
    *points->sent = points_new(context->server, fixed, uv_now(context->loop));
    if (*points->sent == NULL) {
      return job_refuse(&points->job, job_busy());
    }
  }
  if (*points->sent == NULL || !points_is(*points->sent, fixed)) {
    return fixed->part_points == 0
               ? reply_with(points, false)
               : job_refuse(&points->job,
                            wire_error_make(WIRE_STATUS_UNKNOWN_POINTS, "point_first",
                                            "0: the points before it have not been sent here"));
  }
  points->points = *points->sent;
  points_hold(points->points);
  if (fixed->part_points == 0) {
    return reply_with(points, false);
  }
  if (fixed->point_first != points->points->next) {
    return refuse_set(points,
                      wire_error_make(WIRE_STATUS_BAD_VALUE, "point_first",
                                      "the position behind the points that have been sent"));
  }
  const wire_error error = points_reserve(points->points, fixed->part_points);
  return error.status == WIRE_STATUS_OK ? JOB_GOES_ON : refuse_set(points, error);
}

/* Looks the set up, whose tree the cache builds. */
static enum job_outcome look_set_up(struct points_job *points) {
  const uint64_t *set = points->request.fixed.set;
  switch (points_get(&points->job.context->profiles.lookups, &points->lookup, set,
                     points->complete ? points->points : NULL)) {
  case LOOKUP_READY:
    if (*points->sent != NULL && points_is(*points->sent, &points->request.fixed)) {
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
      points_add(points->points, n, points->request.xyz + points->done * GATHER_AXES,
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
  if (!points_has_its_name(points->points)) {
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

static enum job_outcome put_points_reply(struct job *job, uint8_t *at) {
  wire_put_points_reply(at, &points_of(job)->reply);
  return JOB_DONE;
}

static void end_points(struct job *job) {
  struct points_job *points = points_of(job);
  lookup_return(&points->lookup);
  points_release(points->points);
}

const struct job_kind job_kind_POINTS = {
    .start = start_points, .begin_part = put_points_reply, .step = step_points, .end = end_points};
