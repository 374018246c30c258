#include "clients/c/client.h"

#include <stdlib.h>
#include <string.h>

static bool open_stream(dipole_client *client, const char *text, dipole_error *error) {
  libdipole_address address;
  int fd;
  client->address = strdup(text);
  if (client->address == NULL) {
    return libdipole_fail(error, DIPOLE_ERROR_MEMORY, "out of memory");
  }
  if (!libdipole_address_parse(text, &address, error)) {
    return false;
  }
  const bool connected = address.kind == LIBDIPOLE_PRIVATE
                             ? libdipole_daemon_start(address.path, &fd, &client->daemon, error)
                             : libdipole_connect(&address, client->timeout_ms, &fd, error);
  if (connected) {
    libdipole_stream_init(&client->stream, fd);
    client->retry.for_ms = address.kind == LIBDIPOLE_PRIVATE ? 0 : DIPOLE_RETRY_MS;
  }
  return connected;
}

bool dipole_open_within(const char *address, unsigned timeout_ms, dipole_client **client,
                        dipole_error *error) {
  dipole_error unwanted;
  error = error != NULL ? error : &unwanted;
  dipole_client *opened = calloc(1, sizeof *opened);
  *client = NULL;
  if (opened == NULL) {
    return libdipole_fail(error, DIPOLE_ERROR_MEMORY, "out of memory");
  }
  libdipole_stream_init(&opened->stream, -1);
  opened->timeout_ms = timeout_ms;
  if (!open_stream(opened, address != NULL ? address : libdipole_address_default(), error) ||
      !libdipole_hello(opened, error)) {
    dipole_close(opened);
    return false;
  }
  *client = opened;
  return true;
}

bool dipole_open(const char *address, dipole_client **client, dipole_error *error) {
  return dipole_open_within(address, DIPOLE_TIMEOUT_MS, client, error);
}

void dipole_close(dipole_client *client) {
  if (client == NULL) {
    return;
  }
  libdipole_stream_close(&client->stream);
  if (client->daemon > 0) {
    libdipole_daemon_end(client->daemon);
  }
  libdipole_pending_free(client);
  libdipole_info_free(client);
  free(client);
}

void dipole_set_timeout_ms(dipole_client *client, unsigned timeout_ms) {
  client->timeout_ms = timeout_ms;
}
