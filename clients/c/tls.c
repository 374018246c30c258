#include "clients/c/tls.h"

#include <arpa/inet.h>
#include <errno.h>
#include <limits.h>
#include <openssl/err.h>
#include <openssl/ssl.h>
#include <poll.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>

#include "clients/c/clock.h"
#include "clients/c/error.h"
#include "proto/wire.h"

/* Fails with an error that is final: trying again would fail in the same way. */
static bool fail_for_good(dipole_error *error) {
  error->status = WIRE_STATUS_NOT_ALLOWED;
  return false;
}

struct libdipole_tls {
  SSL_CTX *context;
  SSL *ssl;
  int reason; /* OpenSSL's reason code of the last fault; 0: none */
};

/* ---- the socket ------------------------------------------------------------------------------ */

/* OpenSSL's own sockets would raise SIGPIPE in the host program. */
static int send_bytes(BIO *bio, const char *from, int bytes) {
  const ssize_t sent = send((int)(intptr_t)BIO_get_data(bio), from, (size_t)bytes, MSG_NOSIGNAL);
  BIO_clear_retry_flags(bio);
  if (sent < 0 && (errno == EAGAIN || errno == EINTR)) {
    BIO_set_retry_write(bio);
  }
  return (int)sent;
}

static int receive_bytes(BIO *bio, char *to, int bytes) {
  const ssize_t got = recv((int)(intptr_t)BIO_get_data(bio), to, (size_t)bytes, 0);
  BIO_clear_retry_flags(bio);
  if (got < 0 && (errno == EAGAIN || errno == EINTR)) {
    BIO_set_retry_read(bio);
  }
  return (int)got;
}

static long control(BIO *bio, int command, long number, void *pointer) {
  (void)bio, (void)number, (void)pointer;
  return command == BIO_CTRL_FLUSH || command == BIO_CTRL_DUP ? 1 : 0;
}

static BIO_METHOD *method;

static void make_method(void) {
  method = BIO_meth_new(BIO_get_new_index() | BIO_TYPE_SOURCE_SINK, "libdipole");
  if (method != NULL) {
    BIO_meth_set_write(method, send_bytes);
    BIO_meth_set_read(method, receive_bytes);
    BIO_meth_set_ctrl(method, control);
  }
}

static bool set_socket(SSL *ssl, int fd) {
  static pthread_once_t once = PTHREAD_ONCE_INIT;
  pthread_once(&once, make_method);
  BIO *bio = method != NULL ? BIO_new(method) : NULL;
  if (bio == NULL) {
    return false;
  }
  BIO_set_data(bio, (void *)(intptr_t)fd);
  BIO_set_init(bio, 1);
  SSL_set_bio(ssl, bio, bio);
  return true;
}

/* ---- opening --------------------------------------------------------------------------------- */

static const char *fault(void) {
  const unsigned long code =
      ERR_SYSTEM_ERROR(ERR_peek_error()) ? ERR_peek_error() : ERR_peek_last_error();
  const char *reason =
      ERR_SYSTEM_ERROR(code) ? strerror(ERR_GET_REASON(code)) : ERR_reason_error_string(code);
  return reason != NULL ? reason : "no reason is known";
}

static bool fail_file(dipole_error *error, const char *what, const char *path) {
  libdipole_fail(error, DIPOLE_ERROR_CONNECT, "cannot use the %s %.100s: %s", what, path, fault());
  return fail_for_good(error);
}

static int no_password(char *password, int bytes, int writing, void *wanted) {
  (void)password, (void)bytes, (void)writing;
  *(bool *)wanted = true;
  return -1;
}

static bool load(SSL_CTX *context, const libdipole_tls_files *files, dipole_error *error) {
  bool password_wanted = false;
  SSL_CTX_set_default_passwd_cb(context, no_password);
  SSL_CTX_set_default_passwd_cb_userdata(context, &password_wanted);
  if (files->ca != NULL ? SSL_CTX_load_verify_file(context, files->ca) != 1
                        : SSL_CTX_set_default_verify_paths(context) != 1) {
    return fail_file(error, "CA file", files->ca != NULL ? files->ca : "of the system");
  }
  if (files->certificate == NULL) {
    return true;
  }
  if (SSL_CTX_use_certificate_chain_file(context, files->certificate) != 1) {
    return fail_file(error, "certificate", files->certificate);
  }
  const char *key = files->key != NULL ? files->key : files->certificate;
  if (SSL_CTX_use_PrivateKey_file(context, key, SSL_FILETYPE_PEM) == 1 &&
      SSL_CTX_check_private_key(context) == 1) {
    return true;
  }
  if (password_wanted) {
    libdipole_fail(
        error, DIPOLE_ERROR_CONNECT,
        "the key %.100s has a password: give a key without one, as openssl pkey writes it", key);
    return fail_for_good(error);
  }
  return fail_file(error, "key", key);
}

/* Sets whose certificate the peer has to have. */
static bool set_host(SSL *ssl, const char *host) {
  uint8_t number[sizeof(struct in6_addr)];
  if (inet_pton(AF_INET, host, number) == 1 || inet_pton(AF_INET6, host, number) == 1) {
    return X509_VERIFY_PARAM_set1_ip_asc(SSL_get0_param(ssl), host) == 1;
  }
  return SSL_set1_host(ssl, host) == 1 && SSL_set_tlsext_host_name(ssl, host) == 1;
}

static bool set_up(libdipole_tls *tls, int fd, const char *host, const libdipole_tls_files *files,
                   dipole_error *error) {
  ERR_clear_error();
  tls->context = SSL_CTX_new(TLS_client_method());
  if (tls->context == NULL) {
    return libdipole_fail_memory(error);
  }
  SSL_CTX_set_min_proto_version(tls->context, TLS1_2_VERSION);
  SSL_CTX_set_options(tls->context, SSL_OP_NO_COMPRESSION | SSL_OP_NO_RENEGOTIATION |
                                        SSL_OP_IGNORE_UNEXPECTED_EOF);
  SSL_CTX_set_mode(tls->context, SSL_MODE_ENABLE_PARTIAL_WRITE |
                                     SSL_MODE_ACCEPT_MOVING_WRITE_BUFFER |
                                     SSL_MODE_RELEASE_BUFFERS);
  SSL_CTX_set_verify(tls->context, SSL_VERIFY_PEER, NULL);
  if (!load(tls->context, files, error)) {
    return false;
  }
  tls->ssl = SSL_new(tls->context);
  if (tls->ssl == NULL || !set_host(tls->ssl, host) || !set_socket(tls->ssl, fd)) {
    return libdipole_fail_memory(error);
  }
  SSL_set_connect_state(tls->ssl);
  return true;
}

/* Returns whether the peer refuses the certificate, by the numbers of its alerts (RFC 8446, 6.2):
 * handshake_failure and bad_certificate to access_denied, and certificate_required. */
static bool is_refusal(int reason) {
  const int alert = reason - SSL_AD_REASON_OFFSET;
  return (alert >= 40 && alert <= 49) || alert == 116;
}

static bool is_of_unknown_ca(long verified) {
  return verified == X509_V_ERR_SELF_SIGNED_CERT_IN_CHAIN ||
         verified == X509_V_ERR_DEPTH_ZERO_SELF_SIGNED_CERT ||
         verified == X509_V_ERR_UNABLE_TO_GET_ISSUER_CERT_LOCALLY;
}

static bool fail_handshake(const SSL *ssl, int result, const char *host, dipole_error *error) {
  const int number = errno;
  const long verified = SSL_get_verify_result(ssl);
  if (SSL_get_error(ssl, result) != SSL_ERROR_SSL) {
    return libdipole_fail(error, DIPOLE_ERROR_CONNECT,
                          "%.120s ended the TLS handshake%s%s: is it a tls: address?", host,
                          number != 0 ? ": " : "", number != 0 ? strerror(number) : "");
  }
  if (ERR_GET_REASON(ERR_peek_last_error()) == SSL_R_WRONG_VERSION_NUMBER) {
    libdipole_fail(error, DIPOLE_ERROR_CONNECT,
                   "%.120s does not speak TLS at this port: is it a tcp: address?", host);
    return fail_for_good(error);
  }
  libdipole_fail(error, DIPOLE_ERROR_CONNECT, "TLS with %.120s failed: %s%s%s", host,
                 verified != X509_V_OK ? "its certificate: " : "",
                 verified != X509_V_OK ? X509_verify_cert_error_string(verified) : fault(),
                 is_refusal(ERR_GET_REASON(ERR_peek_last_error()))
                     ? " (it refuses this client's certificate, or requires one)"
                 : is_of_unknown_ca(verified) ? " (give its CA, as with --ca)"
                                              : "");
  return fail_for_good(error);
}

static bool shake_hands(libdipole_tls *tls, int fd, const char *host, unsigned timeout_ms,
                        dipole_error *error) {
  const int64_t until_ms = libdipole_now_ms() + timeout_ms;
  for (;;) {
    ERR_clear_error();
    errno = 0;
    const int result = SSL_do_handshake(tls->ssl);
    if (result == 1) {
      return true;
    }
    const int wanted = SSL_get_error(tls->ssl, result);
    if (wanted != SSL_ERROR_WANT_READ && wanted != SSL_ERROR_WANT_WRITE) {
      return fail_handshake(tls->ssl, result, host, error);
    }
    const int64_t left_ms = until_ms - libdipole_now_ms();
    short ready;
    if (!libdipole_wait(fd, wanted == SSL_ERROR_WANT_READ ? POLLIN : POLLOUT,
                        timeout_ms == 0 ? 0
                        : left_ms > 1   ? (unsigned)left_ms
                                        : 1,
                        &ready)) {
      return libdipole_fail_errno(error, DIPOLE_ERROR_CONNECT, errno, "TLS handshake");
    }
  }
}

libdipole_tls *libdipole_tls_open(int fd, const char *host, const libdipole_tls_files *files,
                                  unsigned timeout_ms, dipole_error *error) {
  libdipole_tls *tls = calloc(1, sizeof *tls);
  if (tls == NULL) {
    libdipole_fail_memory(error);
    return NULL;
  }
  if (!set_up(tls, fd, host, files, error) || !shake_hands(tls, fd, host, timeout_ms, error)) {
    libdipole_tls_free(tls, true);
    tls = NULL;
  }
  ERR_clear_error();
  return tls;
}

void libdipole_tls_free(libdipole_tls *tls, bool is_sent) {
  if (tls != NULL) {
    ERR_clear_error();
    if (is_sent && tls->ssl != NULL && SSL_is_init_finished(tls->ssl) && tls->reason == 0) {
      SSL_shutdown(tls->ssl); /* sends the end of the session, if the socket accepts it */
    }
    SSL_free(tls->ssl);
    SSL_CTX_free(tls->context);
    ERR_clear_error();
    free(tls);
  }
}

/* ---- bytes ----------------------------------------------------------------------------------- */

/* Sets errno to what the failure of a read or a write means. Returns 0 at the end, else -1. */
static ssize_t fail_bytes(libdipole_tls *tls, int result) {
  switch (SSL_get_error(tls->ssl, result)) {
  case SSL_ERROR_WANT_READ:
  case SSL_ERROR_WANT_WRITE:
    errno = EAGAIN;
    return -1;
  case SSL_ERROR_ZERO_RETURN:
    return 0;
  case SSL_ERROR_SYSCALL:
    tls->reason = -1;
    errno = errno != 0 ? errno : ECONNRESET;
    return -1;
  default:
    tls->reason = ERR_GET_REASON(ERR_peek_last_error());
    errno = EPROTO;
    return -1;
  }
}

ssize_t libdipole_tls_read(libdipole_tls *tls, void *to, size_t bytes) {
  ERR_clear_error();
  errno = 0;
  const int got = SSL_read(tls->ssl, to, bytes < INT_MAX ? (int)bytes : INT_MAX);
  return got > 0 ? got : fail_bytes(tls, got);
}

ssize_t libdipole_tls_write(libdipole_tls *tls, const void *from, size_t bytes) {
  ERR_clear_error();
  errno = 0;
  const int sent = SSL_write(tls->ssl, from, bytes < INT_MAX ? (int)bytes : INT_MAX);
  return sent > 0 ? sent : fail_bytes(tls, sent);
}

bool libdipole_tls_pending(const libdipole_tls *tls) {
  return SSL_pending(tls->ssl) > 0;
}

const char *libdipole_tls_refusal(const libdipole_tls *tls) {
  return tls->reason > 0 && is_refusal(tls->reason)
             ? ERR_reason_error_string(ERR_PACK(ERR_LIB_SSL, 0, tls->reason))
             : NULL;
}
