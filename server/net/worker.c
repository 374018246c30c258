#include "server/net/worker.h"

#include <assert.h>
#include <string.h>

#include "server/jobs/answer.h"
#include "server/modbus/service.h"

/* ---- the run queue ----------------------------------------------------------------------------
 */

static void on_awake(uv_idle_t *handle) {
  (void)handle;
}

void worker_run_later(struct worker *worker, struct connection *connection) {
  if (connection->to_run) {
    return;
  }
  connection->to_run = true;
  connection->next_to_run = NULL;
  if (worker->run_last == NULL) {
    worker->run_first = connection;
  } else {
    worker->run_last->next_to_run = connection;
  }
  worker->run_last = connection;
  worker->run_count++;
}

static struct connection *next_to_run(struct worker *worker) {
  struct connection *connection = worker->run_first;
  worker->run_first = connection->next_to_run;
  if (worker->run_first == NULL) {
    worker->run_last = NULL;
  }
  worker->run_count--;
  connection->to_run = false;
  return connection;
}

static void remove_from_run_queue(struct worker *worker, struct connection *connection) {
  struct connection *last = NULL;
  struct connection **link = &worker->run_first;
  while (*link != NULL) {
    if (*link == connection) {
      *link = connection->next_to_run;
    } else {
      last = *link;
      link = &(*link)->next_to_run;
    }
  }
  worker->run_last = last;
  worker->run_count--;
  connection->to_run = false;
}

/* For others to see. */
static void publish_queue(struct worker *worker) {
  struct stats *stats = &worker->server->stats;
  stats_set(stats, STATS_QUEUED_CONNECTIONS, worker->run_count);
  stats_set(stats, STATS_OWED_RADII, worker->scratch.backlog.owed_radii);
}

/* One turn for each connection that is in the queue now; those that come back have their next turn
 * after new requests have been read. What is short is evaluated together at the end of all turns,
 * and then written. No connection is freed meanwhile: that takes another round of the loop. */
static void run_round(struct worker *worker) {
  struct connection *last = worker->run_last;
  struct connection *ran = NULL;
  struct connection **end = &ran;
  publish_queue(worker);
  for (bool more = last != NULL; more;) {
    struct connection *connection = next_to_run(worker);
    more = connection != last;
    connection_run(connection);
    connection->next_to_finish = NULL;
    *end = connection;
    end = &connection->next_to_finish;
  }
  modbus_service_run(worker->modbus);
  batch_finish(&worker->scratch.batch, &worker->server->stats);
  modbus_service_finish(worker->modbus);
  for (; ran != NULL; ran = ran->next_to_finish) {
    connection_finish(ran);
  }
  latency_finish(&worker->latency);
  publish_queue(worker);
  worker->round_ns = 0;
}

/* ---- all connections ---------------------------------------------------------------------------
 */

void worker_remember(struct worker *worker, struct connection *connection) {
  connection->previous = NULL;
  connection->next = worker->connections;
  if (worker->connections != NULL) {
    worker->connections->previous = connection;
  }
  worker->connections = connection;
}

void worker_forget(struct worker *worker, struct connection *connection) {
  if (connection->to_run) {
    remove_from_run_queue(worker, connection);
  }
  if (connection->previous != NULL) {
    connection->previous->next = connection->next;
  } else {
    worker->connections = connection->next;
  }
  if (connection->next != NULL) {
    connection->next->previous = connection->previous;
  }
  atomic_fetch_sub_explicit(&worker->connection_count, 1, memory_order_relaxed);
}

static void for_each(struct worker *worker, void (*act)(struct connection *connection)) {
  struct connection *next;
  for (struct connection *c = worker->connections; c != NULL; c = next) {
    next = c->next;
    act(c);
  }
}

/* ---- stopping ---------------------------------------------------------------------------------
 */

/* The first round after the wish reads what had been sent before it; then nothing more is taken. */
static void stop_round(struct worker *worker) {
  if (worker->stop_rounds == 0) {
    return;
  }
  worker->stop_rounds++;
  if (worker->stop_rounds == 3) {
    for_each(worker, connection_stop);
    modbus_service_stop(worker->modbus);
  }
  const uint64_t taken_ms = uv_now(&worker->loop) - worker->stop_began_ms;
  if (taken_ms > worker->server->options.drain_timeout_ms) {
    for_each(worker, connection_abort);
    modbus_service_abort(worker->modbus);
  }
  if (worker->stop_rounds > 3 && worker->connections == NULL &&
      modbus_service_has_stopped(worker->modbus)) {
    uv_stop(&worker->loop);
  }
}

/* ---- the loop ---------------------------------------------------------------------------------
 */

static void take_from_inbox(struct worker *worker) {
  uv_mutex_lock(&worker->mutex);
  struct connection *given = worker->inbox;
  worker->inbox = NULL;
  const bool stop_wanted = worker->stop_wanted;
  uv_mutex_unlock(&worker->mutex);
  while (given != NULL) {
    struct connection *next = given->next_to_run;
    connection_start(given, worker);
    given = next;
  }
  if (stop_wanted && worker->stop_rounds == 0) {
    worker->stop_rounds = 1;
    worker->stop_began_ms = uv_now(&worker->loop);
  }
}

static void on_wake(uv_async_t *handle) {
  struct worker *worker = handle->data;
  take_from_inbox(worker);
  modbus_service_wake(worker->modbus);
  profiles_wake(&worker->profiles);
}

static void wake(void *context) {
  struct worker *worker = context;
  uv_async_send(&worker->wake);
}

/* An active idle handle does that. */
void worker_stay_awake(struct worker *worker) {
  uv_idle_start(&worker->stay_awake, on_awake);
}

/* Timers come before that, too:
 * what they give to the run queue is not to wait for somebody else's bytes. */
static void stay_awake_for_queue(struct worker *worker) {
  if (worker->run_first != NULL) {
    worker_stay_awake(worker);
  }
}

static void after_poll(uv_check_t *handle) {
  struct worker *worker = handle->data;
  run_round(worker);
  stop_round(worker);
  if (worker->run_first != NULL || modbus_service_has_work(worker->modbus) ||
      (worker->stop_rounds > 0 && worker->stop_rounds < 4)) {
    worker_stay_awake(worker);
  } else {
    uv_idle_stop(&worker->stay_awake);
  }
}

static void on_clock(uv_timer_t *timer) {
  struct worker *worker = timer->data;
  const uint64_t now_ms = uv_now(&worker->loop);
  struct connection *next;
  for (struct connection *c = worker->connections; c != NULL; c = next) {
    next = c->next;
    connection_tick(c, now_ms);
  }
  modbus_service_tick(worker->modbus, now_ms);
  profiles_sweep(&worker->profiles);
  repeat_sweep(&worker->scratch.repeat);
  stay_awake_for_queue(worker);
}

static void on_deadline(uv_timer_t *timer) {
  struct worker *worker = timer->data;
  worker->wake_ms = 0;
  for_each(worker, answer_deadline);
  stay_awake_for_queue(worker);
}

void worker_wake_at(struct worker *worker, uint64_t at_ms) {
  if (worker->wake_ms != 0 && worker->wake_ms <= at_ms) {
    return;
  }
  const uint64_t now_ms = uv_now(&worker->loop);
  worker->wake_ms = at_ms;
  uv_timer_start(&worker->deadline, on_deadline, at_ms > now_ms ? at_ms - now_ms : 0, 0);
}

static uint64_t least(uint64_t a, uint64_t b) {
  return a < b ? a : b;
}

/* Timeouts are looked at so often that they are kept to a quarter. */
static uint64_t clock_period_ms(const struct options *options) {
  uint64_t shortest = least(options->frame_timeout_ms, options->idle_timeout_ms);
  shortest = least(shortest, options->modbus_frame_timeout_ms);
  shortest = least(shortest, options->modbus_idle_timeout_ms);
  shortest = least(shortest, options->drain_timeout_ms);
  return least(shortest / 4 + 1, 250);
}

static void close_handle(uv_handle_t *handle, void *unused) {
  (void)unused;
  if (!uv_is_closing(handle)) {
    uv_close(handle, NULL);
  }
}

static void thread_main(void *argument) {
  struct worker *worker = argument;
  stats_claim((unsigned)(worker - worker->server->workers) + 1);
  uv_run(&worker->loop, UV_RUN_DEFAULT);
  assert(worker->connections == NULL);
  modbus_service_end(worker->modbus);
  uv_walk(&worker->loop, close_handle, NULL);
  uv_run(&worker->loop, UV_RUN_DEFAULT); /* to the end of what it has had prepared, too */
  repeat_end(&worker->scratch.repeat);
  profiles_end(&worker->profiles);
  const int closed = uv_loop_close(&worker->loop);
  assert(closed == 0);
}

static int set_up_handles(struct worker *worker) {
  const uint64_t period_ms = clock_period_ms(&worker->server->options);
  uv_check_init(&worker->loop, &worker->after_poll);
  uv_idle_init(&worker->loop, &worker->stay_awake);
  uv_timer_init(&worker->loop, &worker->clock);
  uv_timer_init(&worker->loop, &worker->deadline);
  worker->wake.data = worker->after_poll.data = worker->clock.data = worker;
  worker->deadline.data = worker;
  uv_check_start(&worker->after_poll, after_poll);
  return uv_timer_start(&worker->clock, on_clock, period_ms, period_ms);
}

int worker_start(struct worker *worker, struct server *server) {
  memset(worker, 0, sizeof *worker);
  worker->server = server;
  if (server->modbus != NULL && worker == server->workers) {
    worker->modbus = server->modbus;
    worker->modbus->worker = worker;
  }
  profiles_init(&worker->profiles, server, &worker->loop, wake, worker);
  int error = uv_mutex_init(&worker->mutex);
  error = error != 0 ? error : uv_loop_init(&worker->loop);
  error = error != 0 ? error : uv_async_init(&worker->loop, &worker->wake, on_wake);
  error = error != 0 ? error : set_up_handles(worker);
  return error != 0 ? error : uv_thread_create(&worker->thread, thread_main, worker);
}

void worker_give(struct worker *worker, struct connection *connection) {
  atomic_fetch_add_explicit(&worker->connection_count, 1, memory_order_relaxed);
  uv_mutex_lock(&worker->mutex);
  connection->next_to_run = worker->inbox;
  worker->inbox = connection;
  uv_mutex_unlock(&worker->mutex);
  uv_async_send(&worker->wake);
}

void worker_stop(struct worker *worker) {
  uv_mutex_lock(&worker->mutex);
  worker->stop_wanted = true;
  uv_mutex_unlock(&worker->mutex);
  uv_async_send(&worker->wake);
}

void worker_join(struct worker *worker) {
  uv_thread_join(&worker->thread);
  uv_mutex_destroy(&worker->mutex);
}

uv_loop_t *worker_loop(struct worker *worker) {
  return &worker->loop;
}

struct job_scratch *worker_scratch(struct worker *worker) {
  return &worker->scratch;
}

struct profiles *worker_profiles(struct worker *worker) {
  return &worker->profiles;
}

struct latency *worker_latency(struct worker *worker) {
  return &worker->latency;
}

uint64_t worker_round_ns(struct worker *worker) {
  if (worker->round_ns == 0) {
    worker->round_ns = uv_hrtime();
  }
  return worker->round_ns;
}
