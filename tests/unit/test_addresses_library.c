/* libdipole and several daemons: lists of addresses, which daemon the client takes, and what it
 * does when that daemon is lost, silent, full or replaced by another one. */
#include <signal.h>
#include <time.h>
#include <unistd.h>

#include "clients/c/request.h"
#include "tests/unit/peer_scripts.h"
#include "tests/unit/unit.h"

UNIT_SETUP(make_radii) {
  peer_make_radii();
}

/* ---- lists --------------------------------------------------------------------------------- */

UNIT_TEST(test_lists) {
  static const struct {
    const char *text;
    size_t count;
    const char *last;
  } cases[] = {
      {"unix:/a", 1, "unix:/a"},
      {"unix:/a,b", 1, "unix:/a,b"},
      {"unix:/a,b,,tcp", 1, "unix:/a,b,,tcp"},
      {"unix:/a,tcp:h:1", 2, "tcp:h:1"},
      {"tls:h:1,tcp:h:65535,tls:[::1]:2", 3, "tls:[::1]:2"},
      {"tcp:h:1,tcp:[::1]:2,unix:/x,y", 3, "unix:/x,y"},
      {"unix:/a,,unix:/b", 2, "unix:/b"},
      {"private:", 1, "private:"},
      {"private:/bin/a,b", 1, "private:/bin/a,b"},
  };
  for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
    libdipole_addresses addresses;
    dipole_error error;
    UNIT_FAIL_IF(!libdipole_addresses_parse(cases[i].text, &addresses, &error), "%s: %s",
                 cases[i].text, error.text);
    assert_int_equal(addresses.count, cases[i].count);
    assert_string_equal(addresses.texts[addresses.count - 1], cases[i].last);
    libdipole_addresses_free(&addresses);
  }
}

static void fail_open(const char *text, const char *said) {
  dipole_client *client;
  dipole_error error;
  assert_false(dipole_open(text, &client, &error));
  assert_null(client);
  UNIT_FAIL_IF(error.kind != DIPOLE_ERROR_ADDRESS || strstr(error.text, said) == NULL,
               "%s: kind %d: %s", text, error.kind, error.text);
}

UNIT_TEST(test_wrong_lists) {
  static const struct {
    const char *texts, *said;
  } cases[] = {
      {"|localhost:4817|http://localhost:4817|,unix:/a", "tls:HOST:PORT or private:"},
      {"unix:|unix:/a,unix:", "the path must have 1 to 107 bytes"},
      {"tcp:|tcp:localhost|tcp:localhost:|tcp::4817|tcp:localhost:0|tcp:localhost:65536|"
       "tcp:localhost:48a|tcp:localhost:-1|tcp:[]:4817|unix:/a,tcp:|unix:/a,tcp:h",
       "write tcp:HOST:PORT, with a port from 1 to 65535"},
      {"tls:h|tls:h:0", "write tls:HOST:PORT, with a port from 1 to 65535"},
      {"tcp:::1:4817", "put an IPv6 address in brackets"},
      {"unix:/a,private:|private:,unix:/a|tls:h:1,private:", "a private daemon cannot be one of"},
      {"tcp:h:1, unix:/a|tcp:a:1,b:2|tcp:a:1;tcp:b:2|tcp:h:1,", "nothing but a comma between them"},
  };
  const char *many[DIPOLE_ADDRESSES_MAX + 1];
  for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
    char *whole = strdup(cases[i].texts), *rest = whole;
    for (const char *one; (one = strsep(&rest, "|")) != NULL;) {
      fail_open(one, cases[i].said);
    }
    free(whole);
  }
  for (size_t i = 0; i <= DIPOLE_ADDRESSES_MAX; i++) {
    many[i] = "tcp:localhost:1";
  }
  char *list = peer_list(many, DIPOLE_ADDRESSES_MAX + 1);
  fail_open(list, "more than 16 addresses");
  free(list);
}

/* ---- opening ------------------------------------------------------------------------------- */

UNIT_TEST(test_one_that_does_not_say_hello) {
  dipole_options options = peer_options();
  scripted_peer mute;
  options.connect_timeout_ms = 500;
  options.retry_ms = 0;
  peer_start(&mute, peer_accept_only, NULL);
  peer_start(&peer_of_test, peer_serve, NULL);
  const char *const addresses[] = {mute.address, peer_of_test.address};
  char *list = peer_list(addresses, 2);
  const int64_t start_ms = peer_now_ms();
  dipole_client *client = peer_open(list, &options);
  assert_true(peer_now_ms() - start_ms >= 500);
  peer_check_eval(client, 5);
  peer_end(&mute);
  peer_finish(client);
  free(list);
}

UNIT_TEST(test_opening_again_and_again) {
  peer_script *const scripts[] = {peer_be_full, peer_hang_up_at_once, peer_be_full, peer_serve,
                                  NULL};
  dipole_options options = peer_options();
  peer_start_scripts(&peer_of_test, scripts, NULL);
  const int64_t start_ms = peer_now_ms();
  dipole_client *client = peer_open(peer_of_test.address, &options);
  assert_true(peer_now_ms() - start_ms >= 60); /* twice retry_after_ms of 30 ms */
  peer_check_eval(client, 5);
  peer_finish(client);
}

static void count_and_serve(int fd, void *context) {
  ++*(unsigned *)context;
  peer_serve(fd, NULL);
}

UNIT_TEST(test_clients_spread) {
  enum { CLIENTS = 64 };
  peer_script *scripts[CLIENTS + 1] = {0};
  unsigned counts[2] = {0, 0};
  dipole_options options = peer_options();
  scripted_peer peers[2];
  for (size_t i = 0; i < CLIENTS; i++) {
    scripts[i] = count_and_serve;
  }
  peer_start_scripts(&peers[0], scripts, &counts[0]);
  peer_start_scripts(&peers[1], scripts, &counts[1]);
  const char *const addresses[] = {peers[0].address, peers[1].address};
  char *list = peer_list(addresses, 2);
  options.spread = true;
  for (size_t i = 0; i < CLIENTS; i++) {
    dipole_client *client = peer_open(list, &options);
    peer_check_eval(client, 3);
    dipole_close(client);
  }
  peer_end(&peers[0]);
  peer_end(&peers[1]);
  assert_int_equal(counts[0] + counts[1], CLIENTS);
  assert_true(counts[0] > 0 && counts[1] > 0); /* fails by chance once in 2^63 runs */
  free(list);
}

/* ---- going on elsewhere -------------------------------------------------------------------- */

/* What two daemons do, connection by connection, and who answers in the end. */
static const struct pair {
  peer_script *scripts[2][4];
  unsigned retry_ms;   /* 0: the usual */
  unsigned timeout_ms; /* 0: the usual */
  int64_t least_ms;    /* that an answer takes */
  int answers;         /* the number of the daemon; NOBODY */
} pairs[] = {
#define NOBODY 2
    /* A silent one is left; the other one has as long. */
    {.scripts = {{peer_be_silent}, {peer_serve}}, .timeout_ms = 1000, .answers = 1},
    /* A dead one has a share of the time, so that time is left for the other one. */
    {.scripts = {{peer_hang_up_after_request, peer_serve}, {peer_accept_only}},
     .retry_ms = 2000,
     .least_ms = 500},
    /* One with other lists is passed over. */
    {.scripts = {{peer_hang_up_after_request, peer_serve}, {peer_serve_other_lists}}},
    {.scripts = {{peer_hang_up_after_request}, {peer_hang_up_at_once}},
     .retry_ms = 300,
     .answers = NOBODY},
};

static dipole_client *open_pair(scripted_peer peers[2], peer_script *const scripts[2][4],
                                const dipole_options *options) {
  peer_start_scripts(&peers[0], scripts[0], NULL);
  peer_start_scripts(&peers[1], scripts[1], NULL);
  const char *const addresses[] = {peers[0].address, peers[1].address};
  char *list = peer_list(addresses, 2);
  dipole_client *client = peer_open(list, options);
  free(list);
  return client;
}

static void close_pair(scripted_peer peers[2], dipole_client *client) {
  dipole_close(client);
  peer_end(&peers[0]);
  peer_end(&peers[1]);
}

UNIT_TEST(test_going_on_elsewhere) {
  for (size_t i = 0; i < sizeof pairs / sizeof pairs[0]; i++) {
    const struct pair *row = &pairs[i];
    dipole_options options = peer_options();
    scripted_peer peers[2];
    options.connect_timeout_ms = 0;
    options.retry_ms = row->retry_ms > 0 ? row->retry_ms : options.retry_ms;
    dipole_client *client = open_pair(peers, row->scripts, &options);
    const int64_t start_ms = peer_now_ms();
    if (row->timeout_ms > 0) {
      dipole_set_timeout_ms(client, row->timeout_ms);
    }
    for (int again = 0; row->answers == NOBODY && again < 2; again++) {
      const dipole_error error = peer_check_failure(client, DIPOLE_ERROR_CONNECTION);
      assert_non_null(strstr(error.text, "connecting again failed"));
    }
    if (row->answers != NOBODY) {
      peer_check_eval(client, 5);
      assert_string_equal(dipole_address(client), peers[row->answers].address);
    }
    assert_true(peer_now_ms() - start_ms >= row->least_ms);
    close_pair(peers, client);
  }
}

/* The second daemon answers what the first one did not; after the second is lost, the first again. */
UNIT_TEST(test_round_and_round) {
  peer_script *const scripts[2][4] = {{peer_answer_seven, peer_hang_up_after_request, peer_serve},
                                      {peer_answer_seven, peer_hang_up_after_hello}};
  scripted_peer peers[2];
  dipole_client *client = open_pair(peers, scripts, NULL);
  peer_check_each(client, 25);
  assert_string_equal(dipole_address(client), peers[0].address);
  assert_string_equal(dipole_get_info(client)->address, peers[0].address);
  close_pair(peers, client);
}

/* ---- private daemons ----------------------------------------------------------------------- */

/* Writes the address of a private daemon: the dipoled of the build that has made this program. */
static void private_address(char *address, size_t bytes) {
  char path[PATH_MAX];
  const ssize_t length = readlink("/proc/self/exe", path, sizeof path - 1);
  assert_true(length > 0);
  path[length] = '\0';
  for (unsigned i = 0; i < 3; i++) { /* from BUILD/tests/unit/program to BUILD */
    *strrchr(path, '/') = '\0';
  }
  snprintf(address, bytes, "private:%s/dipoled", path);
}

/* If the client has retries, another private daemon replaces one that has died. */
UNIT_TEST(test_a_private_daemon_that_dies) {
  char address[PATH_MAX + 32];
  dipole_error error;
  private_address(address, sizeof address);
  dipole_client *client = peer_open(address, NULL);
  const pid_t first = client->daemon;
  assert_true(first > 0 && dipole_ping(client, &error));
  assert_int_equal(getpgid(first), first); /* the interrupt key does not end it */
  dipole_set_retry_ms(client, PEER_PATIENCE_MS);
  assert_int_equal(kill(first, SIGKILL), 0);
  peer_expect(dipole_ping(client, &error), &error);
  assert_true(client->daemon > 0 && client->daemon != first);
  assert_int_equal(kill(first, 0), -1); /* The process of the first daemon is gone. */
  dipole_set_retry_ms(client, 0);
  assert_int_equal(kill(client->daemon, SIGKILL), 0);
  assert_false(dipole_ping(client, &error));
  assert_int_equal(error.kind, DIPOLE_ERROR_CONNECTION);
  dipole_close(client);
}
