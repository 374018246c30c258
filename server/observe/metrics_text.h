/* metrics_text: a report in the text format of Prometheus, version 0.0.4. */
#ifndef DIPOLED_METRICS_TEXT_H
#define DIPOLED_METRICS_TEXT_H

#include <stddef.h>

struct server;

/* To be freed; NULL: no memory. */
char *metrics_text(const struct server *server, size_t *bytes);

#endif
