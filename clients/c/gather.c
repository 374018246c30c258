/* Gathers the light of points: requests sums from a daemon, in requests of some thousand queries, and
 * sends it the points when it says that it does not have them. */
#include "proto/gather.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/c/clock.h"
#include "clients/c/error.h"
#include "clients/c/query.h"
#include "clients/c/request.h"
#include "clients/c/table.h"

enum {
  OUTSTANDING = 4, /* the largest number of requests under way */
  PART_POINTS = 65536,
  PART_QUERIES = GATHER_PART_QUERIES,
  SENT_MOST = 4, /* the largest number of times that the points are sent before any sum arrives */
};

/* With tolerance 0: most pairs of query and point in one request, about two seconds of work. */
#define PART_PAIRS ((uint64_t)1 << 30)

struct dipole_points {
  uint64_t point_count;
  uint32_t channel_count;
  const double *xyz_mm; /* the caller's arrays, see dipole_points_make() */
  const float *power_W;
  uint64_t set[2]; /* hash of the content, see PROTOCOL.md G2 */
};

/* ---- points -------------------------------------------------------------------------------- */

bool dipole_points_make(uint64_t point_count, uint32_t channel_count, const double *xyz_mm,
                        const float *power_W, dipole_points **points, dipole_error *error) {
  error = error != NULL ? error : &(dipole_error){0};
  *points = NULL;
  if (point_count < 1 || point_count > CORE_GATHER_POINTS_MAX) {
    return libdipole_fail_argument(error, "point_count is not from 1 to 16777216");
  }
  if (channel_count < 1 || channel_count > CORE_GATHER_CHANNELS_MAX) {
    return libdipole_fail_argument(error, "channel_count is not from 1 to 8");
  }
  if (xyz_mm == NULL || power_W == NULL) {
    return libdipole_fail_argument(error, "xyz_mm or power_W is NULL");
  }
  dipole_points *made = calloc(1, sizeof *made);
  if (made == NULL) {
    return libdipole_fail_memory(error);
  }
  *made = (dipole_points){point_count, channel_count, xyz_mm, power_W, {0, 0}};
  gather_name name;
  gather_name_start(&name, channel_count, point_count);
  gather_name_add(&name, point_count, xyz_mm, power_W);
  gather_name_end(&name, made->set);
  *points = made;
  return true;
}

void dipole_points_free(dipole_points *points) {
  free(points);
}

/* ---- a gather under way -------------------------------------------------------------------- */

struct run {
  dipole_client *client;
  const dipole_gather_query *query;
  double *M;
  uint32_t *order; /* the order in which queries are requested; NULL: as given */
  dipole_gather_result *result;
  uint64_t requested; /* queries of the requests that have been sent */
  uint64_t received;  /* queries whose sums have been received */
  bool known;         /* whether the daemon has shown that it has the points */
  bool sending;       /* whether the points are being sent */
  uint64_t next_point;
  unsigned sent_times;
  int64_t until_ms; /* when the deadline ends, in ms of libdipole_now_ms(); 0: none */
  uint64_t ids[OUTSTANDING];
  /* number of queries in each of these requests; 0 for a part of the points */
  uint64_t counts[OUTSTANDING];
  unsigned under_way;
};

static const libdipole_kind points_kind = {.repeatable = true};

static bool merge_part(const libdipole_pending *pending, const void *part, void *whole) {
  const wire_gather_reply *fixed = part;
  wire_gather_reply *all = whole;
  if (all != NULL) {
    all->bound = fmax(all->bound, fixed->bound);
    all->points_visited += fixed->points_visited;
    all->nodes_visited += fixed->nodes_visited;
    all->notes |= fixed->notes;
  }
  return fixed->channel_count == pending->medium_count && fixed->model == pending->model;
}

static const libdipole_kind gather_kind = {
    .repeatable = true, .reply = &schema_gather_reply, .merge = merge_part};

/* Sets pending's deadline to the time that is left. Returns false if none is. */
static bool set_deadline(const struct run *run, libdipole_pending *pending, dipole_error *error) {
  if (run->until_ms == 0) {
    return true;
  }
  const int64_t left_ms = run->until_ms - libdipole_now_ms();
  pending->deadline_ms = left_ms > 0 ? (uint32_t)left_ms : 0;
  if (left_ms > 0) {
    return true;
  }
  libdipole_fail(error, DIPOLE_ERROR_REFUSED, "the sums take longer than deadline_ms");
  error->status = WIRE_STATUS_DEADLINE;
  strcpy(error->field, "deadline_ms");
  return false;
}

static bool send_points(struct run *run, dipole_error *error) {
  const dipole_points *points = run->query->points, *info = points;
  const uint64_t left = info->point_count - run->next_point;
  const uint64_t n = left < PART_POINTS ? left : PART_POINTS;
  libdipole_pending pending = {.kind = &points_kind,
                               .type = WIRE_TYPE_POINTS,
                               .reply_bytes_min = WIRE_BYTES_points_reply,
                               .reply_bytes_max = WIRE_BYTES_points_reply};
  const wire_points_request fixed = {.set = {points->set[0], points->set[1]},
                                     .channel_count = info->channel_count,
                                     .point_count = info->point_count,
                                     .point_first = run->next_point,
                                     .part_points = n};
  const void *const parts[] = {info->xyz_mm + run->next_point * GATHER_AXES,
                               info->power_W + run->next_point * info->channel_count};
  if (!set_deadline(run, &pending, error) ||
      !libdipole_request_put(run->client, &pending, &schema_points_request, &fixed, parts, error)) {
    return false;
  }
  run->next_point += n;
  run->ids[run->under_way] = pending.id;
  run->counts[run->under_way++] = 0;
  return true;
}

/* Returns the number of queries in the next request. */
static uint64_t next_queries(const struct run *run) {
  const dipole_gather_query *query = run->query;
  const dipole_points *info = query->points;
  const uint64_t left = query->query_count - run->requested;
  uint64_t most = PART_QUERIES;
  if (query->tolerance <= 0) {
    const uint64_t fits = PART_PAIRS / (info->point_count * info->channel_count);
    most = fits < 1 ? 1 : fits < most ? fits : most;
  }
  return left < most ? left : most;
}

/* Returns the index of the query at a position of the order in which queries are sent. */
static uint64_t query_at(const struct run *run, uint64_t position) {
  return run->order != NULL ? run->order[position] : position;
}

static bool request_sums(struct run *run, dipole_error *error) {
  const dipole_gather_query *query = run->query;
  const dipole_points *points = query->points;
  const uint32_t channels = points->channel_count;
  const uint64_t n = next_queries(run);
  libdipole_pending pending = {.kind = &gather_kind,
                               .type = WIRE_TYPE_GATHER,
                               .reply_bytes_min = WIRE_BYTES_gather_reply,
                               .reply_bytes_max = gather_reply_bytes(channels, n),
                               .model = query->model,
                               .medium_count = channels,
                               .layer_count = libdipole_layers(query->layer_count),
                               .radius_count = n};
  const wire_gather_request fixed = {.model = (uint16_t)query->model,
                                     .evaluator = (uint16_t)query->evaluator,
                                     .moments = (uint16_t)query->moments,
                                     .parameter_count = (uint16_t)query->parameter_count,
                                     .medium_count = channels,
                                     .layer_count = pending.layer_count,
                                     .set = {points->set[0], points->set[1]},
                                     .query_count = n,
                                     .tolerance = query->tolerance};
  const void *const parts[] = {query->media, query->parameters, NULL};
  schema_layout layout = {.payload_bytes = UINT64_MAX};
  uint8_t *at;
  schema_lay_out(&schema_gather_request, &fixed, UINT64_MAX, &layout, NULL);
  if (!set_deadline(run, &pending, error) ||
      !libdipole_request_begin(run->client, &pending, layout.payload_bytes, &at, error)) {
    return false;
  }
  libdipole_payload_put(at, &schema_gather_request, &layout, &fixed, parts);
  at += layout.parts[2].at;
  enum { QUERY_BYTES = GATHER_AXES * sizeof(double) };
  for (uint64_t i = 0; i < n; i++) {
    memcpy(at + i * QUERY_BYTES,
           query->queries_mm + query_at(run, run->requested + i) * GATHER_AXES, QUERY_BYTES);
  }
  run->requested += n;
  run->ids[run->under_way] = pending.id;
  run->counts[run->under_way++] = n;
  return libdipole_request_send(run->client, error);
}

/* Sends the next request unless it has to wait. *sent: whether one was sent. */
static bool send_next(struct run *run, bool *sent, dipole_error *error) {
  *sent = false;
  if (run->under_way == OUTSTANDING) {
    return true;
  }
  if (run->sending) {
    *sent = run->next_point < run->query->points->point_count;
    return !*sent || send_points(run, error);
  }
  const bool first = run->under_way == 0 && run->received == 0 && run->requested == 0;
  *sent = first || (run->known && run->requested < run->query->query_count);
  return !*sent || request_sums(run, error);
}

static void drop_all(struct run *run) {
  for (unsigned i = 0; i < run->under_way; i++) {
    libdipole_request_drop(run->client, run->ids[i]);
  }
  run->under_way = 0;
}

/* Cancels the requests under way. Errors are ignored: with the connection, requests end, too. */
static void cancel_all(const struct run *run) {
  for (unsigned i = 0; i < run->under_way; i++) {
    uint64_t cancel_id;
    dipole_error unwanted;
    if (run->counts[i] > 0 && libdipole_cancel(run->client, run->ids[i], &cancel_id, &unwanted)) {
      libdipole_request_drop(run->client, cancel_id);
    }
  }
  dipole_flush(run->client);
}

static void take_sums(struct run *run, const libdipole_frame *frame, uint64_t n) {
  const uint32_t channels = run->query->points->channel_count;
  dipole_gather_result *result = run->result;
  wire_gather_reply fixed;
  wire_get_gather_reply(frame->payload, &fixed);
  const size_t row_bytes = channels * sizeof(double);
  for (uint64_t i = 0; i < n; i++) {
    memcpy(run->M + query_at(run, run->received + i) * channels,
           frame->payload + gather_sums_offset(channels) + i * row_bytes, row_bytes);
  }
  for (uint32_t i = 0; i < channels; i++) {
    wire_quantity_error error;
    wire_get_quantity_error(
        frame->payload + WIRE_BYTES_gather_reply + i * (size_t)WIRE_BYTES_quantity_error, &error);
    result->numerical_error[i] = fmax(result->numerical_error[i], error.numerical_error);
    result->model_error[i] = error.model_error;
  }
  result->bound = fmax(result->bound, fixed.bound);
  result->points_visited += fixed.points_visited;
  result->nodes_visited += fixed.nodes_visited;
  result->notes |= fixed.notes;
  run->received += n;
  result->computed_count = run->received;
  run->known = true;
  run->sent_times = 0;
}

static bool take_points(struct run *run, const libdipole_frame *frame, dipole_error *error) {
  wire_points_reply fixed;
  if (!points_reply_parse(frame->payload, (size_t)frame->payload_bytes, &fixed) ||
      (fixed.known == 0 && fixed.point_next >= run->query->points->point_count)) {
    return libdipole_bad_reply(run->client, "it does not know a set with all its points", error);
  }
  if (fixed.known != 0) {
    run->sending = false;
    run->known = true;
  }
  return true;
}

/* Waits for the reply to the oldest request. */
static bool take_next(struct run *run, dipole_error *error) {
  libdipole_pending pending = {.id = run->ids[0]};
  const uint64_t n = run->counts[0];
  const bool is_points = run->sending || (n == 0 && run->query->query_count > 0);
  libdipole_frame *frame = libdipole_reply(run->client, &pending, error);
  run->under_way--;
  memmove(run->ids, run->ids + 1, run->under_way * sizeof run->ids[0]);
  memmove(run->counts, run->counts + 1, run->under_way * sizeof run->counts[0]);
  if (frame == NULL) {
    if (error->kind != DIPOLE_ERROR_REFUSED || error->status != WIRE_STATUS_UNKNOWN_POINTS ||
        run->sent_times == SENT_MOST) {
      return false;
    }
    drop_all(run);
    run->sent_times++;
    run->sending = true;
    run->known = false;
    run->next_point = 0;
    run->requested = run->received;
    return true;
  }
  bool good = true;
  if (is_points) {
    good = take_points(run, frame, error);
  } else {
    take_sums(run, frame, n);
  }
  free(frame);
  return good;
}

/* Reports progress. Returns whether the caller wants to continue. */
static bool go_on(const struct run *run, uint64_t before,
                  bool (*progress)(void *context, uint64_t done, uint64_t count), void *context) {
  if (progress == NULL || run->received == before) {
    return true;
  }
  run->client->torn = true;
  const bool goes_on = progress(context, run->received, run->query->query_count);
  run->client->torn = false;
  return goes_on;
}

static bool gather(struct run *run, bool (*progress)(void *context, uint64_t done, uint64_t count),
                   void *context, dipole_error *error) {
  while (!run->known || run->sending || run->received != run->query->query_count) {
    bool sent = true;
    while (sent) {
      if (!send_next(run, &sent, error)) {
        return false;
      }
    }
    if (run->under_way == 0) { /* The points were sent again, and no request is to be sent. */
      return true;
    }
    const uint64_t before = run->received;
    if (!take_next(run, error)) {
      return false;
    }
    if (!go_on(run, before, progress, context)) {
      cancel_all(run);
      return true;
    }
  }
  return true;
}

/* ---- the public calls ---------------------------------------------------------------------- */

static bool check(const dipole_gather_query *query, dipole_error *error) {
  if (query->points == NULL || query->media == NULL) {
    return libdipole_fail_argument(error, "points or media is NULL");
  }
  if (query->queries_mm == NULL && query->query_count > 0) {
    return libdipole_fail_argument(error, "queries_mm is NULL although query_count is not 0");
  }
  if (query->query_count > SIZE_MAX / (sizeof(double) * CORE_GATHER_CHANNELS_MAX)) {
    return libdipole_fail_argument(error, "query_count is more than memory holds");
  }
  return libdipole_query_check(query->model, query->evaluator | query->moments, query->parameters,
                               query->parameter_count, error);
}

/* Sorts queries of several requests so that neighbours are in one request: the daemon shares work
 * between them. With a bad query, the order stays, because the daemon names it by its index. */
static void set_order(struct run *run) {
  const dipole_gather_query *query = run->query;
  const uint64_t n = query->query_count;
  if (n <= PART_QUERIES || n > UINT32_MAX || query->tolerance <= 0 ||
      core_gather_check_queries((size_t)n, query->queries_mm).field != NULL) {
    return;
  }
  run->order = malloc((size_t)n * sizeof *run->order);
  if (run->order != NULL) {
    core_gather_order(NULL, (size_t)n, query->queries_mm, run->order);
  }
}

bool dipole_gather(dipole_client *client, const dipole_gather_query *query,
                   bool (*progress)(void *context, uint64_t done, uint64_t count), void *context,
                   double *M_W_per_mm2, dipole_gather_result *result, dipole_error *error) {
  dipole_gather_result unwanted;
  error = error != NULL ? error : &(dipole_error){0};
  result = result != NULL ? result : &unwanted;
  *result = (dipole_gather_result){0};
  if (!check(query, error)) {
    return false;
  }
  struct run run = {
      .client = client,
      .query = query,
      .M = M_W_per_mm2,
      .result = result,
      .until_ms = query->deadline_ms > 0 ? libdipole_now_ms() + query->deadline_ms : 0,
  };
  set_order(&run);
  const bool good = gather(&run, progress, context, error);
  drop_all(&run);
  const uint32_t channels = query->points->channel_count;
  for (uint64_t i = good ? run.received : UINT64_MAX; i < query->query_count; i++) {
    for (uint32_t c = 0; c < channels; c++) {
      M_W_per_mm2[query_at(&run, i) * channels + c] = (double)NAN;
    }
  }
  free(run.order);
  return good;
}

/* ---- at home ------------------------------------------------------------------------------- */

/* The largest number of queries that are copied at a time. */
enum { HOME_QUERIES = 4096 };

/* Work between two calls of progress(), in evaluations of a dipole: about half a second. */
#define HOME_WORK 1e8

/* What dipole_gather_at_home() needs besides the result. */
struct home {
  const dipole_points *info;
  core_gather_points *points;
  core_gather_sum *sum;
  core_gather_scratch *scratch;
  uint32_t *order;
  double queries[HOME_QUERIES][GATHER_AXES]; /* coordinates of the next queries */
  uint32_t places[HOME_QUERIES];             /* 0, 1, ... */
  double M[HOME_QUERIES * CORE_GATHER_CHANNELS_MAX];
  float bound[HOME_QUERIES * CORE_GATHER_CHANNELS_MAX];
  core_gather_visits visits;
};

static bool fail_fault(const core_fault *fault, dipole_error *error) {
  libdipole_fail(error, DIPOLE_ERROR_ARGUMENT, "%s: allowed: %s", fault->field, fault->allowed);
  error->index = fault->index;
  return false;
}

static bool check_home(const dipole_points *info, uint64_t query_count, const double *queries_mm,
                       dipole_error *error) {
  if (queries_mm == NULL && query_count > 0) {
    return libdipole_fail_argument(error, "queries_mm is NULL although query_count is not 0");
  }
  if (query_count > UINT32_MAX) {
    return libdipole_fail_argument(error, "query_count is not below 2^32");
  }
  core_fault fault = core_gather_check_points((size_t)info->point_count, info->xyz_mm,
                                              info->channel_count, info->power_W);
  if (fault.field == NULL) {
    fault = core_gather_check_queries((size_t)query_count, queries_mm);
  }
  return fault.field == NULL || fail_fault(&fault, error);
}

static bool open_home(struct home *home, const core_profile *const *profiles, double tolerance,
                      uint64_t query_count, const double *queries_mm, dipole_error *error) {
  const dipole_points *info = home->info;
  const core_fault fault = core_gather_sum_prepare(&home->sum, core_isa_select(NULL),
                                                   info->channel_count, profiles, tolerance);
  if (fault.field != NULL) {
    return fail_fault(&fault, error);
  }
  home->points = core_gather_points_create((size_t)info->point_count, info->xyz_mm,
                                           info->channel_count, info->power_W);
  while (home->points != NULL && !core_gather_points_build(home->points, UINT64_MAX)) {
  }
  home->scratch = home->points != NULL ? core_gather_scratch_create(home->sum, home->points) : NULL;
  home->order = malloc(((size_t)query_count + 1) * sizeof *home->order);
  if (home->scratch == NULL || home->order == NULL) {
    return libdipole_fail_memory(error);
  }
  core_gather_order(home->points, (size_t)query_count, queries_mm, home->order);
  return true;
}

static void close_home(struct home *home) {
  if (home != NULL) {
    free(home->order);
    core_gather_scratch_free(home->scratch);
    core_gather_points_free(home->points);
    core_gather_sum_free(home->sum);
    free(home);
  }
}

/* Gathers at the next queries of the order. Returns false if the caller wants no more. */
static bool gather_home(struct home *home, uint64_t query_count, const double *queries_mm,
                        bool (*progress)(void *context, uint64_t done, uint64_t count),
                        void *context, double *M, dipole_gather_result *result) {
  const uint32_t channels = home->info->channel_count;
  const uint32_t *order = home->order + result->computed_count;
  const uint64_t left = query_count - result->computed_count;
  const size_t n = left < HOME_QUERIES ? (size_t)left : HOME_QUERIES;
  bool wanted = true;
  for (size_t i = 0; i < n; i++) {
    home->places[i] = (uint32_t)i;
    memcpy(home->queries[i], queries_mm + order[i] * (size_t)GATHER_AXES, sizeof home->queries[i]);
  }
  size_t done = 0;
  while (wanted && done < n) {
    double work = HOME_WORK;
    done += core_gather_on(home->sum, home->points, home->scratch, n - done, home->places + done,
                           home->queries[0], home->M, home->bound, &home->visits, &work);
    wanted = progress == NULL || progress(context, result->computed_count + done, query_count);
  }
  for (size_t i = 0; i < done; i++) {
    memcpy(M + order[i] * (size_t)channels, home->M + i * channels, channels * sizeof *M);
  }
  for (size_t i = 0; i < done * channels; i++) {
    result->bound = fmax(result->bound, (double)home->bound[i]);
  }
  for (uint32_t c = 0; c < channels; c++) {
    result->numerical_error[c] = core_gather_error(home->sum, home->points, c, &home->visits);
  }
  result->computed_count += done;
  result->points_visited = home->visits.points;
  result->nodes_visited = home->visits.nodes;
  return wanted;
}

bool dipole_gather_at_home(const dipole_table *const *tables, const dipole_points *points,
                           double tolerance, uint64_t query_count, const double *queries_mm,
                           bool (*progress)(void *context, uint64_t done, uint64_t count),
                           void *context, double *M_W_per_mm2, dipole_gather_result *result,
                           dipole_error *error) {
  const dipole_points *info = points;
  const core_profile *profiles[CORE_GATHER_CHANNELS_MAX];
  dipole_gather_result unwanted;
  struct home *home = calloc(1, sizeof *home);
  bool wanted = true;
  error = error != NULL ? error : &(dipole_error){0};
  result = result != NULL ? result : &unwanted;
  *result = (dipole_gather_result){0};
  if (home == NULL) {
    return libdipole_fail_memory(error);
  }
  home->info = info;
  for (uint32_t c = 0; c < info->channel_count; c++) {
    profiles[c] = libdipole_table_profile(tables[c]);
    result->model_error[c] =
        core_gather_model_error(libdipole_table_model_errors(tables[c]), &profiles[c]->medium);
    result->notes |= profiles[c]->notes;
  }
  const bool good = check_home(info, query_count, queries_mm, error) &&
                    open_home(home, profiles, tolerance, query_count, queries_mm, error);
  while (good && wanted && result->computed_count < query_count) {
    wanted = gather_home(home, query_count, queries_mm, progress, context, M_W_per_mm2, result);
  }
  for (uint64_t i = result->computed_count; good && i < query_count; i++) {
    for (uint32_t c = 0; c < info->channel_count; c++) {
      M_W_per_mm2[home->order[i] * (size_t)info->channel_count + c] = (double)NAN;
    }
  }
  close_home(home);
  return good;
}
