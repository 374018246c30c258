#include "server/store/points.h"

#include <assert.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>

enum {
  ROWS_MIN = 4096,       /* room for this many points is taken first, and then twice as much */
  RETRY_AFTER_MS = 1000, /* retry_after_ms of BUSY: sets take seconds to send */
  BUILD_NS = 1000000000  /* ns for which one call builds a set's tree */
};

/* What is freed at once. Returning 8 MiB to the system takes less than a millisecond. */
#define FREED_AT_ONCE_BYTES ((uint64_t)8 << 20)

static uint64_t row_bytes(const struct points *points) {
  return points_row_bytes(points->channel_count);
}

struct points *points_new(struct server *server, const wire_points_request *request,
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

bool points_is(const struct points *points, const wire_points_request *request) {
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

wire_error points_reserve(struct points *points, uint64_t n) {
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
  const uint64_t pieces = 1 + points->count * row_bytes(points) / POINTS_TIMED_BYTES;
  return now_ms - points->begun_ms > pieces * points->server->options.frame_timeout_ms;
}

/* ---- freeing --------------------------------------------------------------------------------- */

struct burden {
  void (*destroy)(void *what);
  void *what;
};

static void *destroy_aside(void *argument) {
  const struct burden burden = *(struct burden *)argument;
  free(argument);
  burden.destroy(burden.what);
  return NULL;
}

static void free_aside(void (*destroy)(void *what), void *what, uint64_t bytes) {
  struct burden *burden = bytes > FREED_AT_ONCE_BYTES ? malloc(sizeof *burden) : NULL;
  pthread_t thread;
  if (burden == NULL) {
    destroy(what);
    return;
  }
  *burden = (struct burden){destroy, what};
  if (pthread_create(&thread, NULL, destroy_aside, burden) != 0) {
    free(burden);
    destroy(what);
    return;
  }
  pthread_detach(thread);
}

static void destroy_points(void *what) {
  struct points *points = what;
  free(points->xyz);
  free(points->power);
  free(points);
}

void points_hold(struct points *points) {
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

wire_error points_add(struct points *points, uint64_t n, const double *xyz, const float *power) {
  const uint32_t channels = points->channel_count;
  assert(points->next + n <= points->capacity);
  const core_fault fault = core_gather_check_points((size_t)n, xyz, channels, power);
  if (fault.field != NULL) {
    wire_error error = wire_error_make(WIRE_STATUS_BAD_VALUE, fault.field, fault.allowed);
    error.index = points->next + fault.index;
    return error;
  }
  gather_name_add(&points->name, n, xyz, power);
  memcpy(points->xyz + points->next * GATHER_AXES, xyz, (size_t)n * GATHER_AXES * sizeof *xyz);
  memcpy(points->power + points->next * channels, power, (size_t)(n * channels) * sizeof *power);
  points->next += n;
  return wire_error_none();
}

bool points_has_its_name(struct points *points) {
  uint64_t name[2];
  assert(points->next == points->count);
  gather_name_end(&points->name, name);
  return memcmp(name, points->set, sizeof name) == 0;
}

/* ---- the kind -------------------------------------------------------------------------------- */

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

static void destroy_tree(void *tree) {
  core_gather_points_free(tree);
}

static void free_tree(void *thing) {
  free_aside(destroy_tree, *(core_gather_points **)thing, tree_bytes(thing));
}

static void hold(void *points) {
  points_hold(points);
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
