/* library: libmicrohttpd, and where HTTP is served. */
#ifndef DIPOLED_HTTP_LIBRARY_H
#define DIPOLED_HTTP_LIBRARY_H

#include <microhttpd.h>
#include <stdbool.h>

#include "proto/wire.h"
#include "server/options.h"

/* HTTP_FUNCTION(name) for each function of the library that the daemon uses. */
#define HTTP_FUNCTIONS                                                                             \
  HTTP_FUNCTION(start_daemon)                                                                      \
  HTTP_FUNCTION(stop_daemon)                                                                       \
  HTTP_FUNCTION(quiesce_daemon)                                                                    \
  HTTP_FUNCTION(run)                                                                               \
  HTTP_FUNCTION(get_timeout)                                                                       \
  HTTP_FUNCTION(get_daemon_info)                                                                   \
  HTTP_FUNCTION(get_connection_info)                                                               \
  HTTP_FUNCTION(get_connection_values)                                                             \
  HTTP_FUNCTION(lookup_connection_value)                                                           \
  HTTP_FUNCTION(suspend_connection)                                                                \
  HTTP_FUNCTION(resume_connection)                                                                 \
  HTTP_FUNCTION(create_response_from_buffer)                                                       \
  HTTP_FUNCTION(add_response_header)                                                               \
  HTTP_FUNCTION(queue_response)                                                                    \
  HTTP_FUNCTION(destroy_response)

struct http_library {
#define HTTP_FUNCTION(name) __typeof__(&MHD_##name) name;
  HTTP_FUNCTIONS
#undef HTTP_FUNCTION
};

/* Loads the library for good. If that fails, returns false and sets *why to the reason.
 *
 * The library is loaded only if an option asks for HTTP. Linking it would cost every daemon 2 ms of
 * its start and 2.7 MB, together with the TLS library that it needs. */
bool http_library_load(struct http_library *library, const char **why);

/* Keeps the library from decoding escapes, for MHD_OPTION_UNESCAPE_CALLBACK. If it did, it would
 * take /metrics%00x for /metrics. */
size_t http_library_leave_escaped(void *context, struct MHD_Connection *connection, char *text);

/* Checks the header of a request. Returns 0, or the status of HTTP that refuses it, and sets *error.
 *
 *   400: it is unclear where the request ends (RFC 9112), so no other may be read behind it.
 *   421: it is for another name than this daemon has, as when DNS has been made to lead here.
 *   403: a page of another site asks, which may not, unless it only leads a reader to `open_path`. */
unsigned http_library_check(const struct http_library *library, struct MHD_Connection *connection,
                            const struct options *options, const char *target, const char *version,
                            const char *open_path, wire_error *error);

/* Listens at [HOST]:PORT, where no HOST means the loopback interface. On failure, prints a message
 * with the option's name to standard error and returns -1. */
int http_library_listen(const char *option, const char *address);

#endif
