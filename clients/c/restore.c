/* A lost connection, made good: by another one to the same daemon or to one at another address, and
 * by asking again what is outstanding. */
#include <stdio.h>
#include <stdlib.h>

#include "clients/c/client.h"

/* Whether all that is outstanding can be asked again. What nobody wants any more is taken out.
 * *until_ms: when the time of one of them is over. */
static bool can_restore(dipole_client *client, int64_t *until_ms) {
  const int64_t now_ms = libdipole_now_ms();
  *until_ms = now_ms + client->retry.for_ms;
  for (size_t i = 0; i < client->pending_count;) {
    libdipole_pending *entry = &client->pending[client->pending_begin + i];
    if (entry->dropped) {
      client->dropped_count--;
      libdipole_retry_drop_parts(entry);
      libdipole_pending_remove(client, entry); /* the next one is at position i now */
      continue;
    }
    const bool answered = entry->frame != NULL && libdipole_retry_is_safe(entry->type);
    if (!answered) {
      if (!libdipole_retry_can(entry)) {
        return false;
      }
      const int64_t over_ms = libdipole_retry_trouble_ms(entry, now_ms) + client->retry.for_ms;
      *until_ms = over_ms < *until_ms ? over_ms : *until_ms;
    }
    i++;
  }
  return true;
}

/* The fresh one's connection, and its private daemon, become the client's own; the fresh one is
 * freed, and ends what is left of the client's former daemon. */
static void take_over(dipole_client *client, dipole_client *fresh) {
  const pid_t former = client->daemon;
  free(client->frame);
  client->frame = NULL;
  libdipole_stream_close(&client->stream);
  client->stream = fresh->stream;
  client->daemon = fresh->daemon;
  client->waited_ms = 0;
  libdipole_stream_init(&fresh->stream, -1);
  fresh->daemon = former;
  dipole_close(fresh);
}

static bool send_all_again(dipole_client *client, dipole_error *error) {
  libdipole_pending *first = client->pending + client->pending_begin;
  for (size_t i = 0; i < client->pending_count; i++) {
    if (first[i].frame == NULL && first[i].again_ms == 0) {
      libdipole_retry_drop_parts(&first[i]);
      if (!libdipole_retry_send(client, &first[i], error)) {
        return false;
      }
    }
  }
  return true;
}

/* Waits before the next round. False: there is no time for one, of the requests' (*over) or of the
 * call's, which *error says. */
static bool wait_for_round(dipole_client *client, int64_t until_ms, uint32_t retry_after_ms,
                           bool *over, dipole_error *error) {
  const unsigned usual_ms = libdipole_jitter(&client->retry.random, client->retry.pause_ms);
  const unsigned wait_ms = retry_after_ms > usual_ms ? retry_after_ms : usual_ms;
  unsigned call_ms = wait_ms;
  *over = until_ms - libdipole_now_ms() <= (int64_t)wait_ms;
  if (*over || !libdipole_call_left(client, &call_ms, error)) {
    return false;
  }
  libdipole_sleep_ms(call_ms);
  client->retry.pause_ms = libdipole_pause_twice(client->retry.pause_ms);
  return libdipole_call_left(client, &call_ms, error);
}

/* Tries until the time is over or there is no hope. NULL: *error says why. */
static dipole_client *connect_again(dipole_client *client, int64_t until_ms, dipole_error *error) {
  const dipole_error first = *error;
  dipole_error latest = first;
  bool may_pass = true, over;
  while (may_pass) {
    if (!wait_for_round(client, until_ms, latest.retry_after_ms, &over, error)) {
      if (over) {
        break;
      }
      return NULL;
    }
    const bool call_ends = client->until_ms != 0 && client->until_ms < until_ms;
    dipole_client *fresh =
        libdipole_round(&client->addresses, client->connect_timeout_ms,
                        call_ends ? client->until_ms : until_ms, client, &may_pass, &latest);
    if (fresh != NULL) {
      return fresh;
    }
  }
  libdipole_fail(error, DIPOLE_ERROR_CONNECTION, "%.120s (and connecting again failed: %.100s)",
                 first.text, latest.text);
  error->status = first.status;
  return NULL;
}

/* A daemon that was silent is not asked again, but another one is. */
static bool may_be_restored(const dipole_client *client, const dipole_error *error) {
  return client->retry.for_ms != 0 && client->info.software != NULL &&
         (!client->stream.silent || client->addresses.count > 1) &&
         error->kind == DIPOLE_ERROR_CONNECTION && libdipole_may_pass(error);
}

bool libdipole_restore(dipole_client *client, dipole_error *error) {
  int64_t until_ms;
  if (!may_be_restored(client, error) || !can_restore(client, &until_ms)) {
    return false;
  }
  if (client->retry.pause_ms == 0) { /* it has only just been lost */
    client->retry.pause_ms = LIBDIPOLE_PAUSE_FIRST_MS;
    client->addresses.at = (client->addresses.at + 1) % client->addresses.count;
    /* At once: a daemon that stops waits a while for its clients to close. */
    libdipole_stream_close(&client->stream);
  }
  dipole_client *fresh = connect_again(client, until_ms, error);
  if (fresh == NULL) {
    return false;
  }
  client->retry.pause_ms = 0;
  take_over(client, fresh);
  return send_all_again(client, error);
}
