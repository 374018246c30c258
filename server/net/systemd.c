#include "server/net/systemd.h"

#include <stddef.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

int systemd_sockets(void) {
  const char *process = getenv("LISTEN_PID"), *count = getenv("LISTEN_FDS");
  char *end;
  if (process == NULL || count == NULL || strtol(process, NULL, 10) != (long)getpid()) {
    return 0; /* The sockets were passed to another process, for example the parent. */
  }
  const long passed = strtol(count, &end, 10);
  return *end != '\0' || passed < 0 || passed > SYSTEMD_SOCKETS_MAX ? -1 : (int)passed;
}

void systemd_tell(const char *state) {
  struct sockaddr_un manager = {.sun_family = AF_UNIX};
  const char *path = getenv("NOTIFY_SOCKET");
  const size_t length = path != NULL ? strlen(path) : 0;
  if (length == 0 || length > sizeof manager.sun_path) {
    return;
  }
  memcpy(manager.sun_path, path, length);
  if (path[0] == '@') {
    manager.sun_path[0] = '\0'; /* an abstract socket */
  }
  const int fd = socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  if (fd >= 0) {
    sendto(fd, state, strlen(state), MSG_NOSIGNAL, (const struct sockaddr *)&manager,
           (socklen_t)(offsetof(struct sockaddr_un, sun_path) + length));
    close(fd);
  }
}
