/* header: the checks of a request's header that --http and --metrics share. */
#ifndef DIPOLED_HTTP_HEADER_H
#define DIPOLED_HTTP_HEADER_H

#include <microhttpd.h>
#include <stdbool.h>

#include "proto/wire.h"
#include "server/options.h"

/* Keeps the library from decoding escapes, for MHD_OPTION_UNESCAPE_CALLBACK. If it did, it would
 * take /metrics%00x for /metrics. */
size_t http_header_leave_escaped(void *context, struct MHD_Connection *connection, char *text);

/* Checks the header of a request. Returns 0, or the status of HTTP that refuses it, and sets *error.
 *
 *   400: it is unclear where the request ends (RFC 9112), so no other may be read behind it.
 *   421: it is for another name than this daemon has, as when DNS has been made to lead here.
 *   403: a page of another site sends it; it may only lead a reader to `open_path`. */
unsigned http_header_check(struct MHD_Connection *connection, const struct options *options,
                           const char *target, const char *version, const char *open_path,
                           wire_error *error);

/* Checks the values of --http-name. Prints a message and returns false if one can match no Host. */
bool http_header_check_names(const struct options_list *names);

#endif
