/* Opens clients: connects to one address, or to the first of several that replies. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "clients/c/clock.h"
#include "clients/c/connect.h"
#include "clients/c/error.h"
#include "clients/c/request.h"

/* ---- one daemon ---------------------------------------------------------------------------- */

/* Connects and sends hello. Each of the two steps may take limit_ms. */
static bool greet(dipole_client *client, const char *text, const libdipole_tls_files *files,
                  unsigned limit_ms, dipole_error *error) {
  libdipole_address address;
  int fd;
  if (!libdipole_address_parse(text, &address, error) ||
      !libdipole_connect(&address, limit_ms, &fd, &client->daemon, error)) {
    return false;
  }
  libdipole_stream_init(&client->stream, fd);
  if (address.kind == LIBDIPOLE_TLS) {
    client->stream.tls = libdipole_tls_open(fd, address.host, files, limit_ms, error);
    if (client->stream.tls == NULL) {
      return false;
    }
  }
  snprintf(client->stream.address, sizeof client->stream.address, "%s", text);
  client->call_timeout_ms = limit_ms;
  if (libdipole_hello(client, text, error)) {
    client->call_timeout_ms = 0;
    return true;
  }
  return error->kind == DIPOLE_ERROR_TIMEOUT
             ? libdipole_fail(error, DIPOLE_ERROR_CONNECT, "%.120s does not say hello within %u ms",
                              text, limit_ms)
             : false;
}

static dipole_client *open_one(const char *text, const libdipole_tls_files *files,
                               unsigned limit_ms, dipole_error *error) {
  dipole_client *client = calloc(1, sizeof *client);
  if (client == NULL) {
    libdipole_fail_memory(error);
    return NULL;
  }
  client->process = getpid();
  libdipole_stream_init(&client->stream, -1);
  if (!greet(client, text, files, limit_ms, error)) {
    dipole_close(client);
    return NULL;
  }
  return client;
}

/* ---- one of several daemons ---------------------------------------------------------------- */

/* Returns whether the daemon of `fresh` has all names in the lists of `like`, with the same ids. If
 * so, the ids in requests mean the same to both daemons. */
static bool has_lists_of(const dipole_client *fresh, const dipole_client *like) {
  for (size_t i = 0; i < like->info->choice_count; i++) {
    const dipole_choice *choice = &like->info->choices[i];
    if (choice->name[0] != '\0' && choice->kind != DIPOLE_STATUS &&
        dipole_id(fresh, choice->kind, choice->name) != choice->id) {
      return false;
    }
  }
  return true;
}

static dipole_client *open_like(const char *text, const libdipole_tls_files *files,
                                unsigned limit_ms, const dipole_client *like, dipole_error *error) {
  dipole_client *fresh = open_one(text, files, limit_ms, error);
  if (fresh != NULL && like != NULL && !has_lists_of(fresh, like)) {
    dipole_close(fresh);
    libdipole_fail(error, DIPOLE_ERROR_PROTOCOL,
                   "the daemon there has other lists: open a new client");
    return NULL;
  }
  return fresh;
}

/* Returns how long an attempt at one address may take: the time until until_ms is shared equally
 * among this address and the others that are still to be tried. */
static unsigned attempt_limit(unsigned connect_timeout_ms, int64_t until_ms, size_t others) {
  if (until_ms == INT64_MAX) {
    return connect_timeout_ms;
  }
  const int64_t share_ms = (until_ms - libdipole_now_ms()) / (int64_t)(others + 1);
  const int64_t least_ms = share_ms > 1 ? share_ms : 1;
  return connect_timeout_ms != 0 && connect_timeout_ms < least_ms ? connect_timeout_ms
                                                                  : (unsigned)least_ms;
}

/* Adds the failure at one address to `all`, the failures at the addresses before it. Keeps the
 * earliest retry_after_ms. */
static void add_failure(dipole_error *all, const dipole_error *one, size_t tried, size_t count) {
  const dipole_error before = *all;
  *all = *one;
  if (count > 1) {
    snprintf(all->text, sizeof all->text, "%.*s%s%.*s", (int)sizeof all->text / 2, before.text,
             tried > 0 ? "; " : "", (int)sizeof all->text / 2 - 3, one->text);
    const bool sooner = tried > 0 && before.retry_after_ms < one->retry_after_ms;
    all->retry_after_ms = sooner ? before.retry_after_ms : one->retry_after_ms;
  }
}

/* Tries each of the addresses once, starting at addresses->at, and sets addresses->at to the one
 * that replies. until_ms: when to stop; INT64_MAX is never. like: the client whose lists the daemon
 * must have, or NULL. Returns a client that has no addresses and options yet. Returns NULL if no
 * address works; *may_pass then says whether trying again may help. */
static dipole_client *try_each(libdipole_addresses *addresses, unsigned connect_timeout_ms,
                               int64_t until_ms, const dipole_client *like, bool *may_pass,
                               dipole_error *error) {
  dipole_error one;
  *may_pass = false;
  error->text[0] = '\0';
  for (size_t tried = 0; tried < addresses->count; tried++) {
    const size_t at = (addresses->at + tried) % addresses->count;
    const unsigned limit_ms =
        attempt_limit(connect_timeout_ms, until_ms, addresses->count - tried - 1);
    dipole_client *client = open_like(addresses->texts[at], &addresses->tls, limit_ms, like, &one);
    if (client != NULL) {
      addresses->at = at;
      return client;
    }
    *may_pass = *may_pass || libdipole_is_temporary(&one);
    add_failure(error, &one, tried, addresses->count);
  }
  return NULL;
}

static dipole_client *reopen(dipole_client *client, int64_t until_ms, bool *may_pass,
                             dipole_error *error) {
  return try_each(&client->addresses, client->connect_timeout_ms, until_ms, client, may_pass,
                  error);
}

/* ---- the public calls ---------------------------------------------------------------------- */

void dipole_options_init(dipole_options *options) {
  *options = (dipole_options){.connect_timeout_ms = DIPOLE_CONNECT_TIMEOUT_MS,
                              .timeout_ms = DIPOLE_TIMEOUT_MS,
                              .retry_ms = DIPOLE_RETRY_MS,
                              .in_flight_max = DIPOLE_IN_FLIGHT_MAX};
}

/* Adds to the text of an error for how long the client has tried. */
static void add_time(dipole_error *error, int64_t time_ms) {
  const size_t length = strlen(error->text);
  snprintf(error->text + length, sizeof error->text - length, " (tried for %.1f s)",
           (double)time_ms / 1000);
}

/* Tries all addresses in rounds, until one replies or retry_ms has passed; 0 is one round. */
static dipole_client *try_in_rounds(libdipole_addresses *addresses, unsigned limit_ms,
                                    unsigned retry_ms, uint64_t *random, dipole_error *error) {
  const int64_t start_ms = libdipole_now_ms(), until_ms = start_ms + retry_ms;
  unsigned pause_ms = LIBDIPOLE_PAUSE_FIRST_MS;
  for (;;) {
    bool may_pass;
    dipole_client *client =
        try_each(addresses, limit_ms, retry_ms > 0 ? until_ms : INT64_MAX, NULL, &may_pass, error);
    if (client != NULL || !may_pass) {
      return client;
    }
    const unsigned wait_ms = libdipole_pause(random, &pause_ms, error->retry_after_ms, until_ms);
    if (wait_ms == 0) {
      if (retry_ms > 0) {
        add_time(error, libdipole_now_ms() - start_ms);
      }
      return NULL;
    }
    libdipole_sleep_ms(wait_ms);
  }
}

static dipole_client *open_any(libdipole_addresses *addresses, const dipole_options *options,
                               dipole_error *error) {
  const bool private = libdipole_addresses_is_private(addresses);
  uint64_t random = 0;
  addresses->at = options->spread ? libdipole_random(&random) % addresses->count : 0;
  return try_in_rounds(addresses, private ? options->timeout_ms : options->connect_timeout_ms,
                       private ? 0 : options->retry_ms, &random, error);
}

bool dipole_open_with(const char *address, const dipole_options *options, dipole_client **client,
                      dipole_error *error) {
  dipole_options usual;
  libdipole_addresses addresses;
  error = error != NULL ? error : &(dipole_error){0};
  *client = NULL;
  dipole_options_init(&usual);
  options = options != NULL ? options : &usual;
  const libdipole_tls_files files = {options->ca, options->certificate, options->key};
  dipole_client *opened = libdipole_addresses_parse(address, &addresses, error) &&
                                  libdipole_addresses_set_tls(&addresses, &files, error)
                              ? open_any(&addresses, options, error)
                              : NULL;
  if (opened == NULL) {
    libdipole_addresses_free(&addresses);
    return false;
  }
  opened->addresses = addresses;
  opened->reopen = reopen;
  opened->timeout_ms = options->timeout_ms;
  opened->connect_timeout_ms = options->connect_timeout_ms;
  opened->call_timeout_ms = options->call_timeout_ms;
  opened->in_flight_max = options->in_flight_max;
  opened->retry.for_ms = libdipole_addresses_is_private(&addresses) ? 0 : options->retry_ms;
  *client = opened;
  return true;
}

bool dipole_open(const char *address, dipole_client **client, dipole_error *error) {
  return dipole_open_with(address, NULL, client, error);
}

void dipole_close(dipole_client *client) {
  if (client == NULL) {
    return;
  }
  const bool is_ours = client->process == getpid();
  libdipole_stream_close(&client->stream, is_ours);
  if (is_ours && client->daemon > 0) {
    libdipole_daemon_end(client->daemon);
  }
  libdipole_requests_free(client);
  free(client->info);
  libdipole_addresses_free(&client->addresses);
  free(client);
}

void dipole_set_timeout_ms(dipole_client *client, unsigned timeout_ms) {
  client->timeout_ms = timeout_ms;
}

void dipole_set_call_timeout_ms(dipole_client *client, unsigned call_timeout_ms) {
  client->call_timeout_ms = call_timeout_ms;
}

void dipole_set_retry_ms(dipole_client *client, unsigned retry_ms) {
  client->retry.for_ms = retry_ms;
}

const char *dipole_address(const dipole_client *client) {
  return client->addresses.texts[client->addresses.at];
}
