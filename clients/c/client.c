#include "clients/c/client.h"

#include <stdlib.h>

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
