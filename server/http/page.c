#include "server/http/page.h"

#include <stddef.h>

/* The assembler includes the file page.html: the program needs no path to it at run time. */
__asm__(".pushsection .rodata\n"
        ".globl http_page_data\n"
        ".hidden http_page_data\n"
        ".type http_page_data, %object\n"
        "http_page_data:\n"
        ".incbin \"server/http/page.html\"\n"
        ".globl http_page_data_end\n"
        ".hidden http_page_data_end\n"
        "http_page_data_end:\n"
        ".byte 0\n"
        ".size http_page_data, http_page_data_end - http_page_data\n"
        ".popsection\n");

#pragma GCC visibility push(hidden)
extern const char http_page_data[];
extern const char http_page_data_end[];
#pragma GCC visibility pop

/* The page's own script and style, which the Makefile has summed up, may run, and nothing else. The
 * page may send requests to this daemon alone, and no other page may frame it. */
#define POLICY                                                                                     \
  "default-src 'none'; script-src 'sha256-" PAGE_SCRIPT_SHA256                                     \
  "'; style-src 'sha256-" PAGE_STYLE_SHA256 "'; img-src data:; connect-src 'self'; "               \
  "base-uri 'none'; form-action 'none'; frame-ancestors 'none'; "                                  \
  "require-trusted-types-for 'script'"

static const struct {
  const char *name, *value;
} headers[] = {
    {MHD_HTTP_HEADER_CONTENT_TYPE, "text/html; charset=utf-8"},
    {MHD_HTTP_HEADER_CACHE_CONTROL, "no-cache"},
    {"Content-Security-Policy", POLICY},
    {"Cross-Origin-Opener-Policy", "same-origin"},
    {"Cross-Origin-Resource-Policy", "same-origin"},
    {"Referrer-Policy", "no-referrer"},
    {"X-Content-Type-Options", "nosniff"},
    {"X-Frame-Options", "DENY"},
};

struct MHD_Response *http_page_response(void) {
  struct MHD_Response *response =
      MHD_create_response_from_buffer((size_t)(http_page_data_end - http_page_data),
                                      (void *)(uintptr_t)http_page_data, MHD_RESPMEM_PERSISTENT);
  for (size_t i = 0; response != NULL && i < sizeof headers / sizeof headers[0]; i++) {
    MHD_add_response_header(response, headers[i].name, headers[i].value);
  }
  return response;
}
