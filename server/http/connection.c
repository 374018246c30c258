#include "server/http/connection.h"

#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/uio.h>

#include "server/http/openapi.h"
#include "server/http/page.h"
#include "server/http/reply.h"
#include "server/http/request.h"
#include "server/jobs/call.h"
#include "server/net/worker.h"
#include "server/observe/health.h"

enum {
  HEADER_BYTES = 1024, /* of the library's memory for one connection, beside the URI */
  REST_MS = 1000,      /* the silence after which the connection releases its buffers */
};

/* What a path serves. */
struct route {
  const char *path;
  enum route_kind { PAGE, HEALTH, READINESS, DOCUMENT, LISTS, MEDIA, MESSAGE } kind;
  const schema_message *message; /* MESSAGE */
};

enum state {
  AWAITS,   /* a request has still to arrive, or to arrive completely */
  RECEIVES, /* the header has arrived */
  RUNS,     /* its job runs, and the library leaves the connection alone */
  READY,    /* the reply is complete in the output */
  GIVEN_UP, /* the job was given up, and the connection is to be closed */
  REPLIED,  /* libmicrohttpd has the reply */
};

struct http_connection {
  struct client client; /* first member: see client.h */
  struct http_host *host;
  struct MHD_Connection *handle;
  int fd;

  enum state state;
  uint64_t since_ms; /* when it began to wait for a request */
  bool has_body;     /* whether the request is a POST */
  bool unclear;      /* whether it is unclear where the request ends, so that it is the last one */
  unsigned refused;  /* the status of HTTP by which the header or the body is refused; 0: none */
  wire_error refusal;
  struct route route;
  struct text query; /* of the URI, with a zero byte behind it; empty if there is none */
  struct text body;  /* body of the request, as far as it has arrived */
  struct call call;  /* the same request in the binary protocol */
  bool g_is_default; /* whether the request left g out */
  struct text text;  /* the body of the reply, which libmicrohttpd sends from here */
};

static const struct client_kind kind;

static struct http_connection *connection_of(struct client *client) {
  return (struct http_connection *)(void *)client;
}

static struct http_connection *of_handle(struct MHD_Connection *handle) {
  return MHD_get_connection_info(handle, MHD_CONNECTION_INFO_SOCKET_CONTEXT)->socket_context;
}

static uint64_t now_ms(const struct http_connection *c) {
  return uv_now(&c->host->worker->loop);
}

static const struct options *options_of(const struct http_connection *c) {
  return &c->host->server->options;
}

/* ---- beginning and end ----------------------------------------------------------------------- */

static void open_connection(struct http_host *host, struct MHD_Connection *handle, void **to) {
  struct http_connection *c = calloc(1, sizeof *c);
  *to = c;
  if (c == NULL) {
    return;
  }
  c->client.kind = &kind;
  c->host = host;
  c->handle = handle;
  c->fd = MHD_get_connection_info(handle, MHD_CONNECTION_INFO_CONNECTION_FD)->connect_fd;
  text_init(&c->query, &host->buffers);
  text_init(&c->body, &host->buffers);
  call_init(&c->call, &c->client, &host->buffers, true);
  text_init(&c->text, &host->buffers);
  host->connection_count++;
  worker_adopt(host->worker, &c->client);
  c->since_ms = now_ms(c);
}

static void forget_request(struct http_connection *c) {
  text_free(&c->body);
  text_reset(&c->query);
  call_drop(&c->call);
  text_reset(&c->text);
}

static void free_texts(struct http_connection *c) {
  text_free(&c->query);
  call_free(&c->call);
  text_free(&c->text);
}

/* The library closes no connection whose job runs, so the client is in no queue of the worker. */
static void close_connection(struct http_connection *c) {
  text_free(&c->body);
  free_texts(c);
  worker_forget(&c->client);
  c->host->connection_count--;
  free(c);
}

void http_connection_notify(void *context, struct MHD_Connection *connection, void **socket_context,
                            enum MHD_ConnectionNotificationCode what) {
  if (what == MHD_CONNECTION_NOTIFY_STARTED) {
    open_connection(context, connection, socket_context);
  } else if (*socket_context != NULL) {
    close_connection(*socket_context);
  }
}

/* Returns how much of the library's memory a URI takes: half of it at least is for the text, and each
 * name of a query takes a structure. */
static size_t library_bytes(const char *uri) {
  enum { NAME_BYTES = 56 };
  const size_t half = HTTP_CONNECTION_BYTES / 2, bytes = strlen(uri);
  size_t names = 0;
  for (const char *at = strpbrk(uri, "&?"); at != NULL; at = strpbrk(at + 1, "&?")) {
    names++;
  }
  return (bytes > half ? bytes : half) + names * NAME_BYTES;
}

/* Serves a request whose URI the library has too little memory for: it would close the connection
 * without a word. The rest of the request is thrown away, since the kernel resets a connection that
 * is closed with bytes to read, and the client might lose the reply. */
static void refuse_uri(struct http_connection *c) {
  const wire_error error = wire_error_make(
      WIRE_STATUS_TOO_LARGE, "query", "32 KiB with its names; the body of a POST may be larger");
  char head[160], rest[4096];
  health_note_refusal(c->host->server, &error);
  text_reset(&c->text);
  http_reply_write_error(&error, &c->text);
  const int length = snprintf(head, sizeof head,
                              "HTTP/1.1 414 URI Too Long\r\nConnection: close\r\n"
                              "Content-Type: application/json\r\nContent-Length: %zu\r\n\r\n",
                              c->text.count);
  struct iovec parts[] = {{head, (size_t)length}, {c->text.bytes, c->text.count}};
  const struct msghdr head_and_body = {.msg_iov = parts, .msg_iovlen = 2};
  if (!c->text.failed && sendmsg(c->fd, &head_and_body, MSG_NOSIGNAL | MSG_DONTWAIT) > 0) {
    shutdown(c->fd, SHUT_WR);
  }
  for (int i = 0; i < HTTP_CONNECTION_BYTES / (int)sizeof rest &&
                  recv(c->fd, rest, sizeof rest, MSG_DONTWAIT) == (ssize_t)sizeof rest;
       i++) {
  }
  c->state = REPLIED;
}

void *http_connection_begin(void *context, const char *uri, struct MHD_Connection *connection) {
  struct http_connection *c = of_handle(connection);
  (void)context;
  if (c != NULL) {
    const char *query = strchr(uri, '?');
    text_reset(&c->query);
    if (query != NULL) {
      text_add(&c->query, query + 1, strlen(query));
    }
    c->state = AWAITS;
    if (library_bytes(uri) > HTTP_CONNECTION_BYTES - HEADER_BYTES) {
      refuse_uri(c);
    }
  }
  return c;
}

void http_connection_complete(void *context, struct MHD_Connection *connection, void **state,
                              enum MHD_RequestTerminationCode why) {
  struct http_connection *c = of_handle(connection);
  (void)context, (void)state, (void)why;
  if (c != NULL) {
    forget_request(c);
    c->state = AWAITS;
    c->since_ms = now_ms(c);
  }
}

/* ---- sending --------------------------------------------------------------------------------- */

static void add_headers(const struct http_connection *c, struct MHD_Response *response,
                        unsigned status, uint32_t retry_after_ms) {
  const char *origin = options_of(c)->http_allow_origin;
  char seconds[16];
  MHD_add_response_header(response, MHD_HTTP_HEADER_CONTENT_TYPE, "application/json");
  MHD_add_response_header(response, "X-Content-Type-Options", "nosniff");
  if (status == MHD_HTTP_METHOD_NOT_ALLOWED || status == MHD_HTTP_NO_CONTENT) {
    MHD_add_response_header(response, MHD_HTTP_HEADER_ALLOW,
                            c->route.kind == MESSAGE ? "GET, HEAD, POST" : "GET, HEAD");
  }
  if (status == MHD_HTTP_TOO_MANY_REQUESTS) {
    snprintf(seconds, sizeof seconds, "%u", (unsigned)(retry_after_ms + 999) / 1000);
    MHD_add_response_header(response, MHD_HTTP_HEADER_RETRY_AFTER, seconds);
  }
  if (origin != NULL) {
    MHD_add_response_header(response, "Access-Control-Allow-Origin", origin);
    MHD_add_response_header(response, "Access-Control-Allow-Headers", "Content-Type");
    MHD_add_response_header(response, MHD_HTTP_HEADER_VARY, "Origin");
  }
}

/* Sends a response and frees it. If it is NULL, for lack of memory, closes the connection. */
static enum MHD_Result send_response(struct http_connection *c, unsigned status,
                                     struct MHD_Response *response) {
  c->state = REPLIED;
  if (response == NULL) {
    return MHD_NO;
  }
  if (c->host->stopping || c->unclear) {
    MHD_add_response_header(response, MHD_HTTP_HEADER_CONNECTION, "close");
  }
  const enum MHD_Result sent = MHD_queue_response(c->handle, status, response);
  MHD_destroy_response(response);
  return sent;
}

/* Sends the reply that has been written. */
static enum MHD_Result send_text(struct http_connection *c, unsigned status,
                                 uint32_t retry_after_ms) {
  struct MHD_Response *response =
      c->text.failed
          ? NULL
          : MHD_create_response_from_buffer(c->text.count, c->text.bytes, MHD_RESPMEM_PERSISTENT);
  if (response != NULL) {
    add_headers(c, response, status, retry_after_ms);
  }
  return send_response(c, status, response);
}

/* Sends an error. status: 0 for the one that proto/statuses.def gives it. */
static enum MHD_Result send_error(struct http_connection *c, const wire_error *error,
                                  unsigned status) {
  health_note_refusal(c->host->server, error);
  text_free(&c->text); /* discards what was written before the error */
  const unsigned usual = http_reply_write_error(error, &c->text);
  return send_text(c, status != 0 ? status : usual, error->retry_after_ms);
}

/* ---- the reply ------------------------------------------------------------------------------- */

static wire_error too_large(const struct http_connection *c, const char *field) {
  char allowed[81];
  snprintf(allowed, sizeof allowed, "over HTTP a request and a reply of max_part_bytes, %llu",
           (unsigned long long)options_of(c)->max_part_bytes);
  return wire_error_make(WIRE_STATUS_TOO_LARGE, field, allowed);
}

static void write_reply(struct http_connection *c) {
  const uint8_t *payload = (const uint8_t *)c->call.reply.bytes;
  if (c->route.kind == LISTS) {
    http_reply_write_models(payload, &c->text);
  } else if (c->route.kind == MEDIA) {
    http_reply_write_media(payload, &c->text);
  } else {
    http_reply_write(c->route.message, (const uint8_t *)c->call.payload.bytes, c->g_is_default,
                     payload, c->call.reply.count, &c->text);
  }
}

/* Sends the reply, or the refusal, of a job that has ended. A slow reader holds its text alone. */
static enum MHD_Result send_reply(struct http_connection *c) {
  wire_error error = c->call.error;
  if (error.status == WIRE_STATUS_OK) {
    write_reply(c);
    error = c->text.failed ? job_busy() : error;
  }
  call_drop(&c->call);
  text_trim(&c->text);
  return error.status != WIRE_STATUS_OK ? send_error(c, &error, 0) : send_text(c, MHD_HTTP_OK, 0);
}

/* ---- the job --------------------------------------------------------------------------------- */

/* Starts the job of the payload. The reply is sent at once, or when the job is done. */
static enum MHD_Result start_job(struct http_connection *c, enum wire_type type,
                                 uint32_t deadline_ms) {
  uint64_t budget = JOB_SLICE_RADII;
  call_start(&c->call, type, &c->client.profiles, deadline_ms);
  call_on(&c->call, &budget);
  if (call_take_end(&c->call)) {
    batch_finish(&c->host->worker->context.batch, &c->host->server->stats);
    return send_reply(c);
  }
  c->state = RUNS;
  MHD_suspend_connection(c->handle);
  return MHD_YES;
}

static void resume(struct http_connection *c, enum state state) {
  c->state = state;
  MHD_resume_connection(c->handle);
  worker_run_later(c->host->service);
}

static void give_up(struct http_connection *c) {
  call_drop(&c->call);
  resume(c, GIVEN_UP);
}

/* ---- requests -------------------------------------------------------------------------------- */

/* Returns the path of a request's target. What is sent through a proxy may name the host, too. */
static const char *path_of(const char *target) {
  if (strncasecmp(target, "http://", 7) != 0) {
    return target;
  }
  const char *path = strchr(target + 7, '/');
  return path != NULL ? path : "/";
}

static bool find_route(const char *url, struct route *route) {
  static const struct route routes[] = {{"/", PAGE, NULL},
                                        {"/healthz", HEALTH, NULL},
                                        {"/readyz", READINESS, NULL},
                                        {"/v1/openapi.json", DOCUMENT, NULL},
                                        {"/v1/models", LISTS, NULL},
                                        {"/v1/media", MEDIA, NULL}};
  for (size_t i = 0; i < sizeof routes / sizeof routes[0]; i++) {
    if (strcmp(routes[i].path, url) == 0) {
      *route = routes[i];
      return true;
    }
  }
  for (const schema_message *one = schema_messages; one->type != 0; one++) {
    if (one->about != NULL && strncmp(url, "/v1/", 4) == 0 && strcmp(url + 4, one->name) == 0) {
      *route = (struct route){url, MESSAGE, one};
      return true;
    }
  }
  return false;
}

/* Translates a request into the payload of a message. */
static wire_error translate(struct http_connection *c, uint32_t *deadline_ms) {
  static char none[1];
  const struct text *from = c->has_body ? &c->body : &c->query;
  const wire_error error =
      c->query.failed
          ? job_busy()
          : http_request_translate(c->route.message, from->count > 0 ? from->bytes : none,
                                   from->count, !c->has_body, &c->call.payload,
                                   (size_t)options_of(c)->max_part_bytes, deadline_ms,
                                   &c->g_is_default);
  text_free(&c->body);
  return error;
}

static enum MHD_Result reply_to_message(struct http_connection *c) {
  uint32_t deadline_ms = 0;
  const wire_error error = translate(c, &deadline_ms);
  if (error.status != WIRE_STATUS_OK) {
    stats_add(&c->host->server->stats, job_type_of(c->route.message->type)->requests, 1);
    stats_count_reply(&c->host->server->stats, error.status);
    return send_error(c, &error, 0);
  }
  return start_job(c, c->route.message->type, deadline_ms);
}

static enum MHD_Result send_health(struct http_connection *c, enum health health) {
  http_text_begin(&c->text, NULL, '{');
  http_text_string(&c->text, "status", health_texts[health].name);
  if (health_texts[health].reason[0] != '\0') {
    http_text_string(&c->text, "reason", health_texts[health].reason);
  }
  http_text_end(&c->text, '}');
  return send_text(c, health == HEALTH_OK ? MHD_HTTP_OK : MHD_HTTP_SERVICE_UNAVAILABLE, 0);
}

static enum MHD_Result handle_request(struct http_connection *c) {
  static const wire_hello_request hello = {WIRE_VERSION, WIRE_VERSION, 0};
  switch (c->route.kind) {
  case PAGE:
    return send_response(c, MHD_HTTP_OK, http_page_response());
  case HEALTH:
    return send_health(c, health_of(c->host->server));
  case READINESS:
    return send_health(c, health_readiness(c->host->server));
  case DOCUMENT:
    http_openapi_write(&c->text);
    return send_text(c, MHD_HTTP_OK, 0);
  case LISTS: {
    uint8_t bytes[WIRE_BYTES_hello_request];
    wire_put_hello_request(bytes, &hello);
    text_add(&c->call.payload, bytes, sizeof bytes);
    return start_job(c, WIRE_TYPE_HELLO, 0);
  }
  case MEDIA:
    return start_job(c, WIRE_TYPE_MEDIA, 0);
  case MESSAGE:
    return reply_to_message(c);
  }
  return MHD_NO;
}

static const char *header_of(const struct http_connection *c, const char *name) {
  return MHD_lookup_connection_value(c->handle, MHD_HEADER_KIND, name);
}

/* Checks what the header says of the body. */
static unsigned check_body(struct http_connection *c, wire_error *error) {
  const char *length = header_of(c, MHD_HTTP_HEADER_CONTENT_LENGTH);
  const char *chunks = header_of(c, MHD_HTTP_HEADER_TRANSFER_ENCODING);
  const char *coding = header_of(c, MHD_HTTP_HEADER_CONTENT_ENCODING);
  if (!c->has_body) {
    const bool has_bytes = chunks != NULL || (length != NULL && strtoull(length, NULL, 10) > 0);
    if (has_bytes && c->route.kind == MESSAGE) {
      *error = wire_error_make(WIRE_STATUS_BAD_VALUE, "body", "nothing: POST takes fields as JSON");
      return wire_status_of(error->status)->http;
    }
    return 0;
  }
  const char *type = header_of(c, MHD_HTTP_HEADER_CONTENT_TYPE);
  if (type == NULL || strncasecmp(type, "application/json", 16) != 0 ||
      strchr("; \t", type[16]) == NULL) {
    *error = wire_error_make(WIRE_STATUS_BAD_VALUE, "Content-Type", "application/json");
    return MHD_HTTP_UNSUPPORTED_MEDIA_TYPE;
  }
  if (coding != NULL && strcasecmp(coding, "identity") != 0) {
    *error = wire_error_make(WIRE_STATUS_BAD_VALUE, "Content-Encoding", "none: a body as it is");
    return MHD_HTTP_UNSUPPORTED_MEDIA_TYPE;
  }
  if (length != NULL && strtoull(length, NULL, 10) > options_of(c)->max_part_bytes) {
    *error = too_large(c, "body");
    return wire_status_of(error->status)->http;
  }
  if (c->query.count > 1) {
    *error = wire_error_make(WIRE_STATUS_BAD_VALUE, "query", "none: the request has a body");
    return wire_status_of(error->status)->http;
  }
  return 0;
}

/* Checks a request as far as its header says. Returns the status of HTTP that refuses it, or 0. */
static unsigned check_header(struct http_connection *c, const char *url, const char *method,
                             const char *version, wire_error *error) {
  const bool reads = strcmp(method, "GET") == 0 || strcmp(method, "HEAD") == 0;
  c->has_body = strcmp(method, "POST") == 0;
  const unsigned misfit = http_header_check(c->handle, options_of(c), url, version, "/", error);
  c->unclear = misfit == MHD_HTTP_BAD_REQUEST;
  if (misfit != 0) {
    return misfit;
  }
  if (!find_route(path_of(url), &c->route)) {
    *error = wire_error_make(WIRE_STATUS_BAD_TYPE, "path", "what /v1/openapi.json lists");
    return MHD_HTTP_NOT_FOUND;
  }
  if (strcmp(method, "OPTIONS") == 0 && options_of(c)->http_allow_origin != NULL) {
    return MHD_HTTP_NO_CONTENT;
  }
  if (!reads && !(c->has_body && c->route.kind == MESSAGE)) {
    *error = wire_error_make(WIRE_STATUS_BAD_TYPE, "method", "GET and HEAD, and POST for requests");
    return MHD_HTTP_METHOD_NOT_ALLOWED;
  }
  const unsigned refused = check_body(c, error);
  if (refused != 0) {
    return refused;
  }
  if (c->host->stopping && c->route.kind != HEALTH && c->route.kind != READINESS) {
    *error = wire_error_make(WIRE_STATUS_SHUTTING_DOWN, "daemon",
                             "another one, or this one started again");
    return wire_status_of(error->status)->http;
  }
  return 0;
}

static enum MHD_Result take_end(struct http_connection *c);

/* Notes whether the header refuses the request. The reply has to wait for the end of the request:
 * if it came before, the library would close the connection, and the client might not see it. But if
 * that end is unclear, the connection is to be closed; and a client that waits for leave to send the
 * body waits, and is told at once. */
static enum MHD_Result take_header(struct http_connection *c, const char *url, const char *method,
                                   const char *version) {
  c->refusal = wire_error_none();
  c->refused = check_header(c, url, method, version, &c->refusal);
  c->state = RECEIVES;
  const char *expects = c->refused != 0 ? header_of(c, MHD_HTTP_HEADER_EXPECT) : NULL;
  return c->unclear || (expects != NULL && strcasecmp(expects, "100-continue") == 0) ? take_end(c)
                                                                                     : MHD_YES;
}

/* Takes a part of the body, or drops it if the request is refused anyway. */
static enum MHD_Result take_body(struct http_connection *c, const char *body, size_t *body_bytes) {
  if (c->refused == 0 && c->body.count + *body_bytes > options_of(c)->max_part_bytes) {
    c->refusal = too_large(c, "body");
    c->refused = wire_status_of(c->refusal.status)->http;
  }
  if (c->refused == 0) {
    text_add(&c->body, body, *body_bytes);
  } else {
    text_free(&c->body);
  }
  if (c->body.failed) {
    c->refusal = job_busy();
    c->refused = wire_status_of(c->refusal.status)->http;
  }
  *body_bytes = 0;
  return MHD_YES;
}

/* Serves a request that has arrived completely. */
static enum MHD_Result take_end(struct http_connection *c) {
  if (c->refused == 0) {
    return handle_request(c);
  }
  return c->refused == MHD_HTTP_NO_CONTENT ? send_text(c, c->refused, 0)
                                           : send_error(c, &c->refusal, c->refused);
}

enum MHD_Result http_connection_take(void *context, struct MHD_Connection *connection,
                                     const char *url, const char *method, const char *version,
                                     const char *body, size_t *body_bytes, void **state) {
  struct http_connection *c = of_handle(connection);
  (void)context, (void)state;
  if (c == NULL) {
    return MHD_NO;
  }
  switch (c->state) {
  case AWAITS:
    return take_header(c, url, method, version);
  case RECEIVES:
    return *body_bytes > 0 ? take_body(c, body, body_bytes) : take_end(c);
  case READY:
    return send_reply(c);
  case REPLIED:
  case RUNS:
  case GIVEN_UP:
    return MHD_NO;
  }
  return MHD_NO;
}

/* ---- the client of the worker ---------------------------------------------------------------- */

static void run_turn(struct client *client) {
  struct http_connection *c = connection_of(client);
  uint64_t budget = JOB_SLICE_RADII;
  call_on(&c->call, &budget);
}

static void finish_turn(struct client *client) {
  struct http_connection *c = connection_of(client);
  if (c->state == RUNS && call_take_end(&c->call)) {
    resume(c, READY);
  }
}

static void expire_request(struct client *client) {
  struct http_connection *c = connection_of(client);
  call_expire(&c->call);
}

/* Returns whether the peer has closed its side. The library does not look while a job runs. */
static bool is_abandoned(const struct http_connection *c) {
  struct pollfd peer = {.fd = c->fd, .events = POLLRDHUP};
  return poll(&peer, 1, 0) > 0 && (peer.revents & (POLLRDHUP | POLLHUP | POLLERR)) != 0;
}

/* A request has to arrive within frame_timeout_ms, counted from the last reply. So one rule bounds
 * slow clients and idle ones. */
static void check_time(struct client *client, uint64_t at_ms) {
  struct http_connection *c = connection_of(client);
  if (c->state == RUNS && is_abandoned(c)) {
    give_up(c);
  }
  if (c->state == REPLIED) { /* Releases them: a slow reader does not need them. */
    call_free(&c->call);
  }
  if (c->state != AWAITS && c->state != RECEIVES) {
    return;
  }
  if (at_ms - c->since_ms > options_of(c)->frame_timeout_ms) {
    shutdown(c->fd, SHUT_RDWR);
  } else if (at_ms - c->since_ms > REST_MS) {
    free_texts(c);
  }
}

/* The daemon stops: a connection without a request is closed. */
static void stop_client(struct client *client) {
  struct http_connection *c = connection_of(client);
  if (c->state == AWAITS || c->state == RECEIVES) {
    shutdown(c->fd, SHUT_RDWR);
  }
}

static void abort_client(struct client *client) {
  struct http_connection *c = connection_of(client);
  shutdown(c->fd, SHUT_RDWR);
  if (c->state == RUNS) {
    give_up(c);
  }
}

static bool is_busy(const struct client *client) {
  return ((const struct http_connection *)(const void *)client)->state == RUNS;
}

static const struct client_kind kind = {
    .run = run_turn,
    .finish = finish_turn,
    .tick = check_time,
    .deadline = expire_request,
    .stop = stop_client,
    .abort = abort_client,
    .busy = is_busy,
};
