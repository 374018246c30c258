#include "server/observe/http.h"

#include <dlfcn.h>
#include <string.h>

/* The interface that microhttpd.h of the 0.9 and 1.0 releases declares. */
#define LIBRARY "libmicrohttpd.so.12"

bool http_load(struct http *http, const char **why) {
  void *library = dlopen(LIBRARY, RTLD_NOW | RTLD_LOCAL);
  void *address;
  bool found = library != NULL;
  /* POSIX has functions' addresses fit into void *, which C does not convert. */
#define HTTP_FUNCTION(name)                                                                        \
  address = found ? dlsym(library, "MHD_" #name) : NULL;                                           \
  found = address != NULL;                                                                         \
  memcpy(&http->name, &address, sizeof address);
  HTTP_FUNCTIONS
#undef HTTP_FUNCTION
  *why = found ? NULL : dlerror();
  return found;
}
