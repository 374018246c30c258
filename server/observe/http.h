/* http: libmicrohttpd, loaded when it is needed. Linked, it and what it brings along (TLS, which the
 * metrics have no use for) took 2 ms of every start and 2.7 MB of a daemon that serves no metrics.
 */
#ifndef DIPOLED_HTTP_H
#define DIPOLED_HTTP_H

#include <microhttpd.h>
#include <stdbool.h>

/* HTTP_FUNCTION(name): every one that is used. */
#define HTTP_FUNCTIONS                                                                             \
  HTTP_FUNCTION(start_daemon)                                                                      \
  HTTP_FUNCTION(stop_daemon)                                                                       \
  HTTP_FUNCTION(create_response_from_buffer)                                                       \
  HTTP_FUNCTION(add_response_header)                                                               \
  HTTP_FUNCTION(queue_response)                                                                    \
  HTTP_FUNCTION(destroy_response)

struct http {
#define HTTP_FUNCTION(name) __typeof__(&MHD_##name) name;
  HTTP_FUNCTIONS
#undef HTTP_FUNCTION
};

/* Once; it stays loaded. False: *why says why. */
bool http_load(struct http *http, const char **why);

#endif
