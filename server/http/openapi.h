/* openapi: the description of what HTTP offers, as an OpenAPI document of version 3.0.3, made from
 * the lists of the protocol. */
#ifndef DIPOLED_HTTP_OPENAPI_H
#define DIPOLED_HTTP_OPENAPI_H

#include "server/http/text.h"

void http_openapi_write(struct text *text);

#endif
