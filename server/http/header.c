#include "server/http/header.h"

#include <arpa/inet.h>
#include <ctype.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>

size_t http_header_leave_escaped(void *context, struct MHD_Connection *connection, char *text) {
  (void)context, (void)connection;
  return strlen(text);
}

/* ---- headers --------------------------------------------------------------------------------- */

/* Returns how many letters, digits and marks a text begins with. */
static size_t span(const char *text, const char *marks) {
  size_t length = 0;
  while (isalnum((unsigned char)text[length]) ||
         (text[length] != '\0' && strchr(marks, text[length]) != NULL)) {
    length++;
  }
  return length;
}

/* The lines that are checked. */
enum { HOST, CODING, LENGTH, SITE, MODE, ORIGIN, LINES };

struct header {
  const char *value[LINES]; /* of the last one; NULL: there is none */
  unsigned count[LINES];
  bool broken;
};

static enum MHD_Result note_line(void *context, enum MHD_ValueKind kind, const char *name,
                                 const char *value) {
  static const char *const names[LINES] = {
      [HOST] = "Host",           [CODING] = "Transfer-Encoding", [LENGTH] = "Content-Length",
      [SITE] = "Sec-Fetch-Site", [MODE] = "Sec-Fetch-Mode",      [ORIGIN] = "Origin"};
  struct header *header = context;
  const size_t length = span(name, "!#$%&'*+-.^_`|~");
  (void)kind;
  /* To a line that is folded, the library adds its rest as a part of the name, which it moves behind
   * the value. */
  header->broken |= length == 0 || name[length] != '\0' || strchr(value, '\r') != NULL ||
                    (uintptr_t)value < (uintptr_t)name;
  for (int i = 0; i < LINES; i++) {
    if (strcasecmp(name, names[i]) == 0) {
      header->value[i] = value;
      header->count[i]++;
    }
  }
  return MHD_YES;
}

/* What a name of a host consists of, besides letters and digits. */
#define NAME_MARKS "-._"

bool http_header_check_names(const struct options_list *names) {
  for (size_t i = 0; i < names->count; i++) {
    const char *name = names->items[i];
    const size_t length = strlen(name);
    if (length == 0 || span(name, NAME_MARKS) != length || name[length - 1] == '.') {
      fprintf(stderr, "dipoled: --http-name is a name alone, as farm7.example, not '%s'\n", name);
      return false;
    }
  }
  return true;
}

enum whose { OURS, FOREIGN, MALFORMED };

/* Says whether HOST[:PORT] is an address, localhost, or a name that the options list. */
static enum whose whose_host(const struct options *options, const char *host) {
  char name[256];
  uint8_t address[16];
  const bool brackets = host[0] == '[';
  host += brackets;
  const size_t length = brackets ? strcspn(host, "]") : span(host, NAME_MARKS);
  const char *end = host + length + (brackets && host[length] != '\0');
  end += *end == ':' ? 1 + strspn(end + 1, "0123456789") : 0;
  if (length >= sizeof name || strchr("/?", *end) == NULL || (brackets && host[length] != ']')) {
    return MALFORMED;
  }
  memcpy(name, host, length);
  name[length] = '\0';
  if (brackets) {
    return inet_pton(AF_INET6, name, address) == 1 ? OURS : MALFORMED;
  }
  if (length > 0 && name[length - 1] == '.') {
    name[length - 1] = '\0'; /* removes the dot that ends an absolute name */
  }
  bool ours = strcasecmp(name, "localhost") == 0 || inet_pton(AF_INET, name, address) == 1;
  for (size_t i = 0; i < options->http_name.count; i++) {
    ours |= strcasecmp(name, options->http_name.items[i]) == 0;
  }
  return ours ? OURS : FOREIGN;
}

static bool may_request(const struct options *options, const struct header *header, bool is_open) {
  const char *allowed = options->http_allow_origin;
  return header->value[SITE] == NULL || strcasecmp(header->value[SITE], "cross-site") != 0 ||
         (is_open && header->value[MODE] != NULL &&
          strcasecmp(header->value[MODE], "navigate") == 0) ||
         (allowed != NULL &&
          (strcmp(allowed, "*") == 0 ||
           (header->value[ORIGIN] != NULL && strcmp(allowed, header->value[ORIGIN]) == 0)));
}

unsigned http_header_check(struct MHD_Connection *connection, const struct options *options,
                           const char *target, const char *version, const char *open_path,
                           wire_error *error) {
  struct header header = {0};
  const bool is_old = strcmp(version, MHD_HTTP_VERSION_1_0) == 0;
  MHD_get_connection_values(connection, MHD_HEADER_KIND, note_line, &header);
  const char *host = strncasecmp(target, "http://", 7) == 0 ? target + 7 : header.value[HOST];
  const enum whose whose = host != NULL ? whose_host(options, host) : OURS;
  const char *field =
      header.broken ? "header"
      : whose == MALFORMED || (header.count[HOST] != 1 && !(is_old && !header.count[HOST]))
          ? MHD_HTTP_HEADER_HOST
      : header.count[CODING] + header.count[LENGTH] > 1 ? MHD_HTTP_HEADER_CONTENT_LENGTH
      : header.value[CODING] != NULL && (is_old || strcasecmp(header.value[CODING], "chunked") != 0)
          ? MHD_HTTP_HEADER_TRANSFER_ENCODING
          : NULL;
  if (field != NULL) {
    *error = wire_error_make(WIRE_STATUS_BAD_VALUE, field,
                             "unfolded lines NAME: VALUE, one Host, one Content-Length or chunked");
    return MHD_HTTP_BAD_REQUEST;
  }
  if (whose == FOREIGN) {
    *error = wire_error_make(WIRE_STATUS_NOT_ALLOWED, MHD_HTTP_HEADER_HOST,
                             "an address, localhost, or a name that --http-name gives");
    return MHD_HTTP_MISDIRECTED_REQUEST;
  }
  if (!may_request(options, &header, open_path != NULL && strcmp(target, open_path) == 0)) {
    *error = wire_error_make(WIRE_STATUS_NOT_ALLOWED, "Sec-Fetch-Site",
                             "same-origin; other pages by --http-allow-origin");
    return MHD_HTTP_FORBIDDEN;
  }
  return 0;
}
