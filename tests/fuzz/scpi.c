/* The target `scpi`: a stream of messages, through the socket. */
#include <ctype.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>

#include "server/scpi/connection.h"
#include "tests/fuzz/daemon.h"

/* Returns whether a stream may start an eval or a fit, which take long and have targets of their own:
 * what this one looks for is in texts, settings and Monte Carlo. */
static bool computes(const uint8_t *data, size_t size) {
  static const char *const queries[] = {"r?", "t?", "ta?", "alb", "freq", "imm"};
  char text[5] = "";
  bool found = false;
  for (size_t i = 0; i < size && !found; i++) {
    const size_t end = strlen(text);
    memmove(text, text + (end == 4), 4);
    text[end == 4 ? 3 : end] = data[i] == 0 ? ' ' : (char)tolower(data[i]);
    for (size_t k = 0; k < sizeof queries / sizeof queries[0]; k++) {
      found |= strstr(text, queries[k]) != NULL;
    }
    found |= strncmp(text, "fit", 3) == 0 && text[3] != ':' && text[3] != '\0';
  }
  return found;
}

/* The first two bytes of an input have the meaning that they have for fuzz_connection(). */
void fuzz_scpi(const uint8_t *data, size_t size) {
  int fds[2];
  struct fuzz_bytes answers = {0};
  if (size < 3 || computes(data + 2, size - 2)) {
    return;
  }
  CHECK(socketpair(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0, fds) == 0);
  struct scpi_connection *client = scpi_connection_new(&fuzz_server, fds[0]);
  stats_add(&fuzz_server.stats, STATS_SCPI_CONNECTIONS_OPEN, 1);
  worker_give(&fuzz_worker, &client->transport.client);
  struct fuzz_delivery delivery = fuzz_delivery_begin(data, 1);
  delivery.at = data + 2;
  delivery.left = size - 2;
  fuzz_daemon_talk(fds[1], &delivery, data[1], &answers);
  CHECK((data[1] & 1) != 0 || answers.count == 0 || answers.bytes[answers.count - 1] == '\n');
  while (stats_get(&fuzz_server.stats, STATS_SCPI_CONNECTIONS_OPEN) > 0) {
    fuzz_daemon_run(UV_RUN_ONCE);
  }
  fuzz_daemon_check_freed();
  free(answers.bytes);
}
