#include "server/net/worker.h"

#include <assert.h>
#include <errno.h>
#include <sys/prctl.h>
#include <sys/timerfd.h>
#include <unistd.h>

#include "server/jobs/run.h"

/* ---- the run queue --------------------------------------------------------------------------- */

void worker_run_later(struct client *client) {
  struct worker *worker = client->worker;
  if (client->run_queue == NULL) {
    client->run_queue =
        worker->in_round ? &worker->going_on[worker->next_going_on] : &worker->arrived;
    TAILQ_INSERT_TAIL(client->run_queue, client, in_run_queue);
    worker->run_count++;
  }
}

void worker_finish_later(struct client *client) {
  if (!client->to_finish) {
    client->to_finish = true;
    TAILQ_INSERT_TAIL(&client->worker->finish_queue, client, in_finish_queue);
  }
}

static void leave_run_queue(struct client *client) {
  TAILQ_REMOVE(client->run_queue, client, in_run_queue);
  client->worker->run_count--;
  client->run_queue = NULL;
}

static void leave_finish_queue(struct client *client) {
  TAILQ_REMOVE(&client->worker->finish_queue, client, in_finish_queue);
  client->to_finish = false;
}

/* Publishes the length of the run queue and the owed work in the statistics. */
static void publish_queue(struct worker *worker) {
  struct stats *stats = &worker->server->stats;
  stats_set(stats, STATS_QUEUED_CONNECTIONS, worker->run_count);
  stats_set(stats, STATS_OWED_RADII, worker->context.owed_radii);
}

/* Gives one turn to each client of the queue. After all turns, evaluates the short requests of
 * these clients together and lets the clients write. */
static void serve(struct worker *worker, struct client_queue *queue) {
  struct client *client;
  while ((client = TAILQ_FIRST(queue)) != NULL) {
    leave_run_queue(client);
    worker->running = client;
    client->kind->run(client);
    if (worker->running != NULL) { /* The client still exists after its turn. */
      worker_finish_later(client);
    }
  }
  batch_finish(&worker->context.batch, &worker->server->stats);
  while ((client = TAILQ_FIRST(&worker->finish_queue)) != NULL) {
    leave_finish_queue(client);
    if (client->kind->finish != NULL) {
      client->kind->finish(client);
    }
  }
  latency_finish(worker->context.latency);
}

/* Serves the clients that something has arrived for, and then those that go on with earlier work:
 * so a short request waits for a turn of each large one at most once. A client that comes back to
 * the queue has its next turn in a later round. A turn may end other clients, which leave whatever
 * queue they are in. */
static void run_round(struct worker *worker) {
  struct client_queue *earlier = &worker->going_on[worker->next_going_on];
  publish_queue(worker);
  worker->next_going_on = !worker->next_going_on;
  worker->in_round = true;
  serve(worker, &worker->arrived);
  if (!TAILQ_EMPTY(earlier)) {
    serve(worker, earlier);
  }
  worker->in_round = false;
  publish_queue(worker);
  worker->load_most = worker->run_count > worker->load_most ? worker->run_count : worker->load_most;
  worker->round_ns = 0;
}

/* ---- all clients ----------------------------------------------------------------------------- */

void worker_adopt(struct worker *worker, struct client *client) {
  client->worker = worker;
  LIST_INSERT_HEAD(&worker->clients, client, in_clients);
  if (client->kind->start != NULL) {
    client->kind->start(client);
  }
}

void worker_forget(struct client *client) {
  struct worker *worker = client->worker;
  if (client->to_finish) {
    leave_finish_queue(client);
  }
  if (client->run_queue != NULL) {
    leave_run_queue(client);
  }
  worker->running = worker->running == client ? NULL : worker->running;
  if (worker->next_client == client) {
    worker->next_client = LIST_NEXT(client, in_clients);
  }
  LIST_REMOVE(client, in_clients);
  atomic_fetch_sub_explicit(&worker->client_count, client->kind->counts, memory_order_relaxed);
}

static void stop_client(struct client *client) {
  client->kind->stop(client);
}

/* Aborts a client after the drain timeout. */
static void abort_client(struct client *client) {
  client->worker->abandoned_count += client->kind->busy != NULL && client->kind->busy(client);
  if (client->kind->abort != NULL) {
    client->kind->abort(client);
  }
}

static void tell_deadline(struct client *client) {
  if (client->kind->deadline != NULL) {
    client->kind->deadline(client);
  }
}

static void tick_client(struct client *client) {
  if (client->kind->tick != NULL) {
    client->kind->tick(client, uv_now(&client->worker->loop));
  }
}

static void for_each(struct worker *worker, void (*act)(struct client *client)) {
  worker->next_client = LIST_FIRST(&worker->clients);
  for (struct client *client; (client = worker->next_client) != NULL;) {
    worker->next_client = LIST_NEXT(client, in_clients); /* worker_forget() moves it on */
    act(client);
  }
}

/* ---- stopping -------------------------------------------------------------------------------- */

/* Stops the clients in two rounds. The first round after worker_stop() still reads the bytes that
 * clients had sent before. The second round calls their stop(). */
static void stop_round(struct worker *worker) {
  if (worker->stop_rounds == 0) {
    return;
  }
  worker->stop_rounds++;
  if (worker->stop_rounds == 3) {
    for_each(worker, stop_client);
  }
  const uint64_t taken_ms = uv_now(&worker->loop) - worker->stop_began_ms;
  if (taken_ms > worker->server->options.drain_timeout_ms) {
    for_each(worker, abort_client);
  }
  if (worker->stop_rounds > 3 && LIST_EMPTY(&worker->clients) && worker->client_count == 0) {
    uv_stop(&worker->loop);
  }
}

/* ---- the loop -------------------------------------------------------------------------------- */

static void take_from_inbox(struct worker *worker) {
  uv_mutex_lock(&worker->mutex);
  STAILQ_HEAD(, client) given = STAILQ_HEAD_INITIALIZER(given);
  STAILQ_CONCAT(&given, &worker->inbox);
  const bool stop_wanted = worker->stop_wanted;
  uv_mutex_unlock(&worker->mutex);
  struct client *client;
  while ((client = STAILQ_FIRST(&given)) != NULL) {
    STAILQ_REMOVE_HEAD(&given, in_inbox);
    worker_adopt(worker, client);
    if (worker->stop_rounds >= 3) {
      stop_client(client);
    }
  }
  if (stop_wanted && worker->stop_rounds == 0) {
    worker->stop_rounds = 1;
    worker->relief = NULL;
    worker->stop_began_ms = uv_now(&worker->loop);
  }
}

static void on_wake(uv_async_t *handle) {
  struct worker *worker = handle->data;
  take_from_inbox(worker);
  lookups_wake(&worker->context.profiles.lookups);
}

static void wake(void *context) {
  struct worker *worker = context;
  uv_async_send(&worker->wake);
}

static void on_awake(uv_idle_t *handle) {
  (void)handle;
}

/* Returns whether the round after the next poll has work that no event announces. */
static bool has_work(const struct worker *worker) {
  const bool stops =
      worker->stop_rounds > 0 && (worker->stop_rounds < 4 || LIST_EMPTY(&worker->clients));
  return worker->run_count > 0 || !TAILQ_EMPTY(&worker->finish_queue) || stops;
}

/* Keeps libuv from sleeping in the poll that follows, if there is work. libuv calls timers, pending
 * writes and closed handles outside of the poll, and any of them may have put a client into a queue,
 * which would otherwise wait there until bytes arrive for another client or the clock ticks. */
static void before_poll(uv_prepare_t *handle) {
  struct worker *worker = handle->data;
  if (has_work(worker)) {
    uv_idle_start(&worker->stay_awake, on_awake);
  } else {
    uv_idle_stop(&worker->stay_awake);
  }
  if (worker->run_count > 0 && uv_backend_timeout(&worker->loop) != 0) {
    stats_add(&worker->server->stats, STATS_LOST_WAKEUPS, worker->run_count);
  }
}

/* Notes the time of the loop, which libuv has read before or after the poll. */
static void note_round(struct worker *worker) {
  atomic_store_explicit(&worker->round_began_ms, uv_now(&worker->loop), memory_order_relaxed);
}

uint64_t worker_silence_ms(const struct worker *workers, uint64_t count) {
  uint64_t latest_ms = 0;
  for (uint64_t i = 0; i < count; i++) {
    const uint64_t began_ms =
        atomic_load_explicit(&workers[i].round_began_ms, memory_order_relaxed);
    latest_ms = began_ms > latest_ms ? began_ms : latest_ms;
  }
  const uint64_t now_ms = uv_hrtime() / 1000000;
  return now_ms > latest_ms ? now_ms - latest_ms : 0;
}

static void after_poll(uv_check_t *handle) {
  struct worker *worker = handle->data;
  note_round(worker);
  run_round(worker);
  stop_round(worker);
}

struct worker *worker_least_busy(struct server *server) {
  struct worker *best = &server->workers[0];
  for (uint64_t i = 1; i < server->options.workers; i++) {
    struct worker *worker = &server->workers[i];
    if (worker->load < best->load ||
        (worker->load == best->load && worker->client_count < best->client_count)) {
      best = worker;
    }
  }
  return best;
}

/* Looks for a worker that has as much less work that both have more alike after one client has moved. */
static void find_relief(struct worker *worker) {
  struct worker *least = worker_least_busy(worker->server);
  const bool helps = worker->stop_rounds == 0 && worker->load_most > least->load + 1;
  worker->relief = helps ? least : NULL;
  worker->load = worker->load_most;
  worker->load_most = 0;
}

static void on_clock(uv_poll_t *clock, int status, int events) {
  struct worker *worker = clock->data;
  uint64_t ticks;
  (void)status, (void)events;
  if (read(worker->clock_fd, &ticks, sizeof ticks) < 0) {
    return;
  }
  find_relief(worker);
  for_each(worker, tick_client);
  profiles_sweep(&worker->context.profiles);
}

static void on_deadline(uv_timer_t *timer) {
  struct worker *worker = timer->data;
  worker->wake_ms = 0;
  for_each(worker, tell_deadline);
}

/* A timer of 0 ms that is set in the call of a timer is called again before libuv polls. */
void worker_wake_at(struct worker *worker, uint64_t at_ms) {
  if (worker->wake_ms != 0 && worker->wake_ms <= at_ms) {
    return;
  }
  const uint64_t now_ms = uv_now(&worker->loop);
  worker->wake_ms = at_ms;
  uv_timer_start(&worker->deadline, on_deadline, at_ms > now_ms ? at_ms - now_ms : 1, 0);
}

static uint64_t least(uint64_t a, uint64_t b) {
  return a < b ? a : b;
}

/* Returns the period at which timeouts are checked: short enough that the shortest timeout is
 * exceeded by a quarter at most. */
static uint64_t clock_period_ms(const struct options *options) {
  uint64_t shortest = least(options->frame_timeout_ms, options->idle_timeout_ms);
  shortest = least(shortest, options->modbus_frame_timeout_ms);
  shortest = least(shortest, options->modbus_idle_timeout_ms);
  shortest = least(shortest, options->drain_timeout_ms);
  return least(shortest / 4 + 1, WORKER_CLOCK_MOST_MS);
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
  prctl(PR_SET_NAME, "worker"); /* name of the thread, for top -H and debuggers */
  uv_run(&worker->loop, UV_RUN_DEFAULT);
  assert(LIST_EMPTY(&worker->clients));
  uv_walk(&worker->loop, close_handle, NULL);
  uv_run(&worker->loop, UV_RUN_DEFAULT);
  run_free_slots(&worker->context);
  profiles_end(&worker->context.profiles);
  const int closed = uv_loop_close(&worker->loop);
  assert(closed == 0);
  close(worker->clock_fd);
}

static int start_clock(struct worker *worker) {
  const struct timespec tick = {.tv_nsec =
                                    (long)clock_period_ms(&worker->server->options) * 1000000};
  const struct itimerspec ticks = {tick, tick};
  worker->clock_fd = timerfd_create(CLOCK_MONOTONIC, TFD_NONBLOCK | TFD_CLOEXEC);
  const bool set = worker->clock_fd >= 0 && timerfd_settime(worker->clock_fd, 0, &ticks, NULL) == 0;
  return set ? 0 : uv_translate_sys_error(errno);
}

static int set_up_handles(struct worker *worker) {
  uv_prepare_init(&worker->loop, &worker->before_poll);
  uv_check_init(&worker->loop, &worker->after_poll);
  uv_idle_init(&worker->loop, &worker->stay_awake);
  uv_timer_init(&worker->loop, &worker->deadline);
  const int error = uv_poll_init(&worker->loop, &worker->clock, worker->clock_fd);
  worker->wake.data = worker->after_poll.data = worker->clock.data = worker;
  worker->deadline.data = worker->before_poll.data = worker;
  uv_prepare_start(&worker->before_poll, before_poll);
  uv_check_start(&worker->after_poll, after_poll);
  return error != 0 ? error : uv_poll_start(&worker->clock, UV_READABLE, on_clock);
}

int worker_open(struct worker *worker, struct server *server) {
  worker->server = server;
  STAILQ_INIT(&worker->inbox);
  TAILQ_INIT(&worker->arrived);
  TAILQ_INIT(&worker->going_on[0]);
  TAILQ_INIT(&worker->going_on[1]);
  TAILQ_INIT(&worker->finish_queue);
  worker->context.server = server;
  worker->context.buffers = &server->buffers;
  worker->context.loop = &worker->loop;
  worker->context.latency = &server->latencies[worker - server->workers];
  profiles_init(&worker->context.profiles, server, wake, worker);
  int error = start_clock(worker);
  error = error != 0 ? error : uv_mutex_init(&worker->mutex);
  error = error != 0 ? error : uv_loop_init(&worker->loop);
  error = error != 0 ? error : uv_async_init(&worker->loop, &worker->wake, on_wake);
  if (error == 0) {
    note_round(worker);
  }
  return error != 0 ? error : set_up_handles(worker);
}

int worker_start(struct worker *worker, struct server *server) {
  const int error = worker_open(worker, server);
  return error != 0 ? error : uv_thread_create(&worker->thread, thread_main, worker);
}

static void put_into_inbox(struct worker *worker, struct client *client) {
  uv_mutex_lock(&worker->mutex);
  STAILQ_INSERT_TAIL(&worker->inbox, client, in_inbox);
  uv_mutex_unlock(&worker->mutex);
  uv_async_send(&worker->wake);
}

void worker_give(struct worker *worker, struct client *client) {
  atomic_fetch_add_explicit(&worker->client_count, client->kind->counts, memory_order_relaxed);
  put_into_inbox(worker, client);
}

bool worker_expect(struct worker *worker) {
  uv_mutex_lock(&worker->mutex);
  const bool goes_on = !worker->stop_wanted;
  worker->client_count += goes_on;
  worker->load += goes_on; /* until its next tick: so that not all others choose it */
  uv_mutex_unlock(&worker->mutex);
  return goes_on;
}

void worker_move(struct client *client, struct worker *to) {
  worker_forget(client);
  put_into_inbox(to, client);
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

uint64_t worker_round_ns(struct worker *worker) {
  if (worker->round_ns == 0) {
    worker->round_ns = uv_hrtime();
  }
  return worker->round_ns;
}
