/* page: the page that --http serves at /: page.html, as part of the program's read-only data. */
#ifndef DIPOLED_HTTP_PAGE_H
#define DIPOLED_HTTP_PAGE_H

#include <microhttpd.h>

/* Makes the reply that holds the page, with all its headers. Returns NULL if there is no memory.
 * The caller destroys it. */
struct MHD_Response *http_page_response(void);

#endif
