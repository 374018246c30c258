#include "server/net/systemd.h"

#include <dlfcn.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "server/observe/log.h"

#define LIBRARY "libsystemd.so.0"

enum { FIRST_SOCKET = 3 }; /* SD_LISTEN_FDS_START */

static bool is_set(const char *variable) {
  const char *value = getenv(variable);
  return value != NULL && *value != '\0';
}

/* Returns whether the variables are meant for this process and not for its parent. */
static bool has_sockets(void) {
  return is_set("LISTEN_FDS") && is_set("LISTEN_PID") &&
         strtol(getenv("LISTEN_PID"), NULL, 10) == (long)getpid();
}

static bool load(struct systemd *systemd, const char **why) {
  void *library = dlopen(LIBRARY, RTLD_NOW | RTLD_LOCAL);
  void *address;
  bool found = library != NULL;
  /* POSIX guarantees that a function's address fits into a void *. C has no conversion between
   * them, so the address is copied by memcpy(). */
#define SYSTEMD_FUNCTION(name, parameters)                                                         \
  address = found ? dlsym(library, "sd_" #name) : NULL;                                            \
  found = address != NULL;                                                                         \
  memcpy(&systemd->name, &address, sizeof address);
  SYSTEMD_FUNCTIONS
#undef SYSTEMD_FUNCTION
  *why = found ? NULL : dlerror();
  return found;
}

bool systemd_open(struct systemd *systemd, const char **why) {
  *systemd = (struct systemd){0};
  if ((!has_sockets() && !is_set("NOTIFY_SOCKET")) || load(systemd, why)) {
    return true;
  }
  *systemd = (struct systemd){0};
  if (!has_sockets()) {
    log_line(LOG_LEVEL_ERROR, "event=not-notifying reason=\"%s\"", *why);
  }
  return !has_sockets();
}

int systemd_sockets(const struct systemd *systemd, int *first, const char **why) {
  const int count = systemd->listen_fds != NULL ? systemd->listen_fds(0) : 0;
  *first = FIRST_SOCKET;
  if (count < 0) {
    *why = strerror(-count);
  } else if (count > SYSTEMD_SOCKETS_MAX) {
    *why = "more sockets are passed than are taken (SYSTEMD_SOCKETS_MAX)";
  }
  return count < 0 || count > SYSTEMD_SOCKETS_MAX ? -1 : count;
}

/* Notifies the manager. Ignores failures, because the manager has then ended. */
static void tell(const struct systemd *systemd, const char *state) {
  if (systemd->notify != NULL) {
    systemd->notify(0, state);
  }
}

void systemd_tell_ready(const struct systemd *systemd) {
  tell(systemd, "READY=1\nSTATUS=Serving.");
}

void systemd_tell_stopping(const struct systemd *systemd) {
  tell(systemd, "STOPPING=1\nSTATUS=Answering what is in flight.");
}
