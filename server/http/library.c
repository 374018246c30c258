#include "server/http/library.h"

#include <dlfcn.h>
#include <errno.h>
#include <stdio.h>
#include <string.h>

#include "server/net/tcp.h"

/* The version of the library whose interface microhttpd.h of the 0.9 and 1.0 releases declares. */
#define LIBRARY "libmicrohttpd.so.12"

bool http_library_load(struct http_library *library, const char **why) {
  void *handle = dlopen(LIBRARY, RTLD_NOW | RTLD_LOCAL);
  void *address;
  bool found = handle != NULL;
  /* POSIX guarantees that a function's address fits into a void *. C has no conversion between
   * them, so the address is copied by memcpy(). */
#define HTTP_FUNCTION(name)                                                                        \
  address = found ? dlsym(handle, "MHD_" #name) : NULL;                                            \
  found = address != NULL;                                                                         \
  memcpy(&library->name, &address, sizeof address);
  HTTP_FUNCTIONS
#undef HTTP_FUNCTION
  *why = found ? NULL : dlerror();
  return found;
}

size_t http_library_leave_escaped(void *context, struct MHD_Connection *connection, char *text) {
  (void)context, (void)connection;
  return strlen(text);
}

int http_library_listen(const char *option, const char *address) {
  char local[64];
  const char *port = strchr(address, ':') == NULL ? address
                     : address[0] == ':'          ? address + 1
                                                  : NULL;
  const char *why;
  if (port != NULL) {
    snprintf(local, sizeof local, "127.0.0.1:%s", port);
  }
  const int fd = tcp_listen(port != NULL ? local : address, &why);
  if (fd < 0) {
    fprintf(stderr, "dipoled: --%s %s: %s. Write HOST:PORT, or a PORT of this machine\n", option,
            address, errno == EADDRINUSE ? "another process listens there" : why);
  }
  return fd;
}
