/* The run queue of a worker, with clients that do nothing but queue, forget and free each other, or
 * that libuv calls outside of its poll. */
#include "server/net/worker.h"

#include <sys/socket.h>
#include <unistd.h>

#include "server/net/transport.h"
#include "server/store/cache.h"
#include "tests/unit/unit.h"

enum { TURNS = 20000, LEAVERS = 24 };

struct fixture {
  struct server server;
  struct worker worker;
  struct latency latency;
};

/* Serves a client until it forgets itself, and stops the worker. */
static void serve(struct fixture *f, struct client *client) {
  memset(f, 0, sizeof *f);
  f->server.options.frame_timeout_ms = f->server.options.idle_timeout_ms = 8;
  f->server.options.modbus_frame_timeout_ms = f->server.options.modbus_idle_timeout_ms = 8;
  f->server.options.drain_timeout_ms = 600000;
  f->server.isa = core_isa_select(NULL);
  f->server.cache = cache_new(f->server.isa, 1 << 20, 0, 1, &f->server.stats);
  f->server.workers = &f->worker;
  f->server.latencies = &f->latency;
  assert_int_equal(worker_start(&f->worker, &f->server), 0);
  worker_give(&f->worker, client);
  worker_join(&f->worker);
  cache_free(f->server.cache);
  assert_int_equal(stats_get(&f->server.stats, STATS_LOST_WAKEUPS), 0);
}

/* ---- wake-ups -------------------------------------------------------------------------------- */

/* Its turns come from callbacks that libuv calls outside of its poll, each in turn. */
struct waking {
  struct client client;
  unsigned turns;
  int pair[2];
  uv_pipe_t pipe;
  uv_write_t write;
  uv_timer_t timer, closing;
};

static struct waking *waking_of(struct client *client) {
  return (struct waking *)(void *)client;
}

static void on_written(uv_write_t *write, int status) {
  assert_int_equal(status, 0);
  worker_run_later(write->data);
}

static void on_time(uv_timer_t *timer) {
  worker_run_later(timer->data);
}

static void on_closed(uv_handle_t *handle) {
  worker_run_later(handle->data);
}

static void waking_start(struct client *client) {
  struct waking *w = waking_of(client);
  assert_int_equal(uv_socketpair(SOCK_STREAM, 0, w->pair, UV_NONBLOCK_PIPE, UV_NONBLOCK_PIPE), 0);
  uv_pipe_init(&client->worker->loop, &w->pipe, 0);
  assert_int_equal(uv_pipe_open(&w->pipe, w->pair[0]), 0);
  uv_timer_init(&client->worker->loop, &w->timer);
  w->write.data = w->timer.data = w->closing.data = client;
  worker_run_later(client);
}

static void waking_run(struct client *client) {
  struct waking *w = waking_of(client);
  uv_buf_t byte = uv_buf_init((char[]){0}, 1);
  char read_back;
  if (++w->turns == TURNS) {
    uv_close((uv_handle_t *)&w->pipe, NULL);
    uv_close((uv_handle_t *)&w->timer, NULL);
    close(w->pair[1]);
    worker_stop(client->worker);
  } else if (w->turns % 3 ==
             0) { /* succeeds at once, so that libuv tells it before the next poll */
    assert_int_equal(uv_write(&w->write, (uv_stream_t *)&w->pipe, &byte, 1, on_written), 0);
    assert_int_equal(read(w->pair[1], &read_back, 1), 1);
  } else if (w->turns % 3 == 1) {
    uv_timer_start(&w->timer, on_time, 0, 0);
  } else {
    uv_timer_init(&client->worker->loop, &w->closing);
    uv_close((uv_handle_t *)&w->closing, on_closed);
  }
}

UNIT_TEST(no_wake_up_is_left_to_the_clock) {
  static const struct client_kind kind = {
      .start = waking_start, .run = waking_run, .stop = worker_forget, .abort = worker_forget};
  static struct waking client;
  static struct fixture f;
  client.client.kind = &kind;
  serve(&f, &client.client);
  assert_int_equal(client.turns, TURNS);
}

/* ---- deadlines ------------------------------------------------------------------------------- */

/* Asks to be woken in so many ms, and looks when the worker will wake, without waiting for it. */
static void ask_to_wake(struct client *client, uint64_t asked_ms, uint64_t due_ms) {
  worker_wake_at(client->worker, uv_now(&client->worker->loop) + asked_ms);
  assert_int_equal(uv_timer_get_due_in(&client->worker->deadline), due_ms);
}

static void waiter_start(struct client *client) {
  ask_to_wake(client, 900000, 900000);
  ask_to_wake(client, 300000, 300000);
  ask_to_wake(client, 600000, 300000);
  ask_to_wake(client, 0, 1);
}

static void waiter_deadline(struct client *client) {
  ask_to_wake(client, 600000, 600000); /* The deadline that has passed does not hide a later one. */
  worker_stop(client->worker);
}

UNIT_TEST(the_earliest_deadline_wakes) {
  static const struct client_kind kind = {
      .start = waiter_start, .deadline = waiter_deadline, .stop = worker_forget};
  static struct client client = {.kind = &kind};
  static struct fixture f;
  serve(&f, &client);
}

/* ---- leaving --------------------------------------------------------------------------------- */

static void on_dropped(struct transport *t) {
  assert_true(t->closing);
}

static void on_left(struct transport *t) {
  worker_stop(t->client.worker);
}

static void lingerer_start(struct client *client) {
  struct transport *t = transport_of(client);
  assert_true(transport_open(t));
  transport_linger(t);
  const uint64_t now_ms = t->active_ms;
  assert_true(transport_is_over(t, now_ms + 1000) && !t->closing);
  assert_true(transport_is_over(t, now_ms + 1001) && t->closing);
}

/* It may still read the last reply until then. */
UNIT_TEST(a_peer_has_a_second_to_leave) {
  static const struct client_kind kind = {.start = lingerer_start};
  static const struct transport_calls calls = {.dropped = on_dropped, .closed = on_left};
  static struct transport client;
  static struct fixture f;
  int pair[2];
  assert_int_equal(socketpair(AF_UNIX, SOCK_STREAM, 0, pair), 0);
  transport_init(&client, &kind, &calls, &f.server, pair[0], NULL);
  serve(&f, &client.client);
  close(pair[1]);
}

/* Clients that at random moments give each other turns, forget and free each other, and come anew. */
struct leaver {
  struct client client;
  struct leavers *all;
  bool awaits_turn; /* whether worker_run_later() was called after its last turn */
};

struct leavers {
  struct client client; /* goes on until TURNS turns have been had */
  uint64_t random;
  unsigned turns, left;
  struct leaver *here[LEAVERS];
};

static const struct client_kind leaver_kind;

static void leave(struct leavers *all, size_t i) {
  if (all->here[i] != NULL) {
    worker_forget(&all->here[i]->client);
    free(all->here[i]);
    all->here[i] = NULL;
    all->left++;
  }
}

static void act_at_random(struct leavers *all) {
  for (size_t acts = unit_random_below(&all->random, 6); acts > 0; acts--) {
    const size_t i = unit_random_below(&all->random, LEAVERS);
    if (all->here[i] == NULL) {
      all->here[i] = calloc(1, sizeof *all->here[i]);
      all->here[i]->client.kind = &leaver_kind;
      all->here[i]->all = all;
      worker_adopt(all->client.worker, &all->here[i]->client);
    }
    switch (unit_random_below(&all->random, 5)) {
    case 0:
      leave(all, i);
      break;
    case 1:
      worker_finish_later(&all->here[i]->client);
      break;
    default:
      all->here[i]->awaits_turn = true;
      worker_run_later(&all->here[i]->client);
    }
  }
}

static void leaver_run(struct client *client) {
  struct leaver *one = (struct leaver *)(void *)client;
  one->awaits_turn = false;
  one->all->turns++;
  act_at_random(one->all);
}

static void leaver_act(struct client *client) {
  act_at_random(((struct leaver *)(void *)client)->all);
}

static void leaver_tick(struct client *client, uint64_t now_ms) {
  (void)now_ms;
  leaver_act(client);
}

static void leaver_stop(struct client *client) {
  (void)client; /* leavers_run() has let all go. */
}

static const struct client_kind leaver_kind = {.start = leaver_stop,
                                               .run = leaver_run,
                                               .finish = leaver_act,
                                               .tick = leaver_tick,
                                               .stop = leaver_stop,
                                               .abort = leaver_stop};

/* Sees in each of its turns that no client waits for one in vain. */
static void leavers_run(struct client *client) {
  struct leavers *all = (struct leavers *)(void *)client;
  for (size_t i = 0; i < LEAVERS; i++) {
    assert_true(all->here[i] == NULL ||
                all->here[i]->awaits_turn == (all->here[i]->client.run_queue != NULL));
  }
  act_at_random(all);
  if (all->turns < TURNS) {
    worker_run_later(client);
    return;
  }
  for (size_t i = 0; i < LEAVERS; i++) {
    leave(all, i);
  }
  worker_stop(client->worker);
}

UNIT_TEST(clients_are_forgotten_at_any_time) {
  static const struct client_kind kind = {
      .start = worker_run_later, .run = leavers_run, .stop = worker_forget, .abort = worker_forget};
  static struct leavers all;
  static struct fixture f;
  all.client.kind = &kind;
  all.random = unit_seed();
  serve(&f, &all.client);
  assert_true(all.turns >= TURNS);
  assert_true(all.left > TURNS / 10);
}
