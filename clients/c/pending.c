/* What has been asked and has no answer yet, or one that nobody has collected. */
#include <stdlib.h>
#include <string.h>

#include "clients/c/client.h"
#include "proto/mc.h"

libdipole_pending *libdipole_pending_find(dipole_client *client, uint64_t id) {
  libdipole_pending *first = client->pending + client->pending_begin;
  size_t begin = 0, end = client->pending_count;
  while (begin < end) {
    const size_t middle = begin + (end - begin) / 2;
    if (first[middle].id < id) {
      begin = middle + 1;
    } else {
      end = middle;
    }
  }
  return begin < client->pending_count && first[begin].id == id ? &first[begin] : NULL;
}

libdipole_pending *libdipole_pending_arrived(dipole_client *client) {
  libdipole_pending *first = client->pending + client->pending_begin;
  for (size_t i = 0; client->arrived_count > 0 && i < client->pending_count; i++) {
    if (first[i].frame != NULL) { /* answers come nearly in order, so this is a short walk */
      return &first[i];
    }
  }
  return NULL;
}

bool libdipole_pending_reserve(dipole_client *client, dipole_error *error) {
  if (client->pending_begin + client->pending_count < client->pending_capacity) {
    return true;
  }
  if (client->pending_begin > client->pending_capacity / 2) {
    memmove(client->pending, client->pending + client->pending_begin,
            client->pending_count * sizeof *client->pending);
    client->pending_begin = 0;
    return true;
  }
  const size_t capacity = client->pending_capacity == 0 ? 16 : 2 * client->pending_capacity;
  libdipole_pending *larger = reallocarray(client->pending, capacity, sizeof *larger);
  if (larger == NULL) {
    return libdipole_fail(error, DIPOLE_ERROR_MEMORY, "out of memory");
  }
  client->pending = larger;
  client->pending_capacity = capacity;
  return true;
}

bool libdipole_is_progress(const libdipole_frame *frame) {
  wire_mc_reply reply;
  if (frame->header.type != (WIRE_TYPE_MC | WIRE_REPLY)) {
    return false;
  }
  wire_get_mc_reply(frame->payload, &reply); /* no shorter: see check_header() */
  return reply.state == MC_UNDER_WAY;
}

void libdipole_pending_remove(dipole_client *client, libdipole_pending *entry) {
  libdipole_retry_forget(client, entry);
  libdipole_pending *first = client->pending + client->pending_begin;
  const size_t before = (size_t)(entry - first);
  const size_t after = --client->pending_count - before;
  if (before < after) {
    memmove(first + 1, first, before * sizeof *first);
    client->pending_begin++;
  } else {
    memmove(entry, entry + 1, after * sizeof *entry);
  }
}

void libdipole_pending_take(dipole_client *client, libdipole_pending *entry,
                            libdipole_pending *out) {
  *out = *entry;
  client->arrived_count--;
  if (libdipole_is_progress(entry->frame)) {
    entry->frame = NULL;
  } else {
    libdipole_pending_remove(client, entry);
  }
}

void libdipole_pending_drop(dipole_client *client, uint64_t id) {
  libdipole_pending *entry = libdipole_pending_find(client, id);
  if (entry == NULL || entry->dropped) {
    return;
  }
  const bool under_way = entry->frame == NULL && entry->again_ms == 0;
  if (under_way) {
    entry->dropped = true;
    client->dropped_count++;
    libdipole_into_discard(client, id);
    return;
  }
  client->arrived_count -= entry->frame != NULL;
  free(entry->frame);
  free(entry->gathered);
  libdipole_pending_remove(client, entry);
}

size_t dipole_outstanding(const dipole_client *client) {
  return client->pending_count - client->dropped_count;
}

void libdipole_pending_free(dipole_client *client) {
  for (size_t i = 0; i < client->pending_count; i++) {
    libdipole_pending *entry = &client->pending[client->pending_begin + i];
    free(entry->frame);
    free(entry->gathered);
    free(entry->kept);
  }
  free(client->pending);
  free(client->frame);
  client->pending = NULL;
  client->frame = NULL;
  client->pending_count = 0;
}
