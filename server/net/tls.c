#include "server/net/tls.h"

#include <errno.h>
#include <openssl/err.h>
#include <openssl/pem.h>
#include <openssl/ssl.h>
#include <openssl/x509v3.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <uv.h>

#include "server/observe/log.h"

static bool has_tls(const struct options_list *urls) {
  for (size_t i = 0; i < urls->count; i++) {
    if (strncmp(urls->items[i], "tls:", 4) == 0) {
      return true;
    }
  }
  return false;
}

bool tls_is_wanted(const struct options *options) {
  return has_tls(&options->listen) || has_tls(&options->modbus);
}

#define ROLE_OID "1.3.6.1.4.1.50316.802.1"

enum { CERTIFICATES_BYTES = 32768, CHAIN_LENGTH = 8 }; /* limits of a client's certificates */
enum {
  FEED_BYTES = 32768, /* received at a time: two records, of which each call decrypts one */
  KEPT_BYTES = 512,   /* memory that a silent connection keeps for the next ones */
};
enum { SUBJECT_BYTES = 1024, ROLE_BYTES = 128 };

static int roles_index; /* index of the roles in an SSL_CTX, which frees them */

struct tls {
  const struct options *options;
  SSL_CTX *context;
};

/* ---- certificates ---------------------------------------------------------------------------- */

static void describe_fault(char why[TLS_WHY_BYTES]) {
  /* later errors of the queue say where the first was noticed */
  const unsigned long error = ERR_peek_error();
  const char *reason = ERR_reason_error_string(error);
  if (ERR_GET_LIB(error) == ERR_LIB_SSL && (ERR_GET_REASON(error) == SSL_R_WRONG_VERSION_NUMBER ||
                                            ERR_GET_REASON(error) == SSL_R_HTTP_REQUEST)) {
    reason = "the peer does not speak TLS, or a balancer's PROXY header comes before it";
  } else if (ERR_GET_LIB(error) == ERR_LIB_X509 &&
             ERR_GET_REASON(error) == X509_R_KEY_VALUES_MISMATCH) {
    reason = "this is not the key of --certificate";
  } else if (ERR_SYSTEM_ERROR(error)) {
    reason = strerror(ERR_GET_REASON(error));
  } else if (ERR_GET_REASON(error) == ERR_R_UNSUPPORTED ||
             (ERR_GET_LIB(error) == ERR_LIB_PEM && ERR_GET_REASON(error) == PEM_R_NO_START_LINE)) {
    reason = "the file has no such content in PEM, which begins with -----BEGIN";
  }
  snprintf(why, TLS_WHY_BYTES, "%s", reason != NULL ? reason : "no reason is known");
  ERR_clear_error();
}

/* Keys with a password are refused: OpenSSL would prompt at the terminal. */
static int no_password(char *password, int bytes, int writing, void *wanted) {
  (void)password, (void)bytes, (void)writing;
  *(bool *)wanted = true;
  return -1;
}

static void set_manners(SSL_CTX *context) {
  SSL_CTX_set_min_proto_version(context, TLS1_2_VERSION);
  SSL_CTX_set_options(context, SSL_OP_NO_COMPRESSION | SSL_OP_NO_RENEGOTIATION | SSL_OP_NO_TICKET |
                                   SSL_OP_CIPHER_SERVER_PREFERENCE | SSL_OP_IGNORE_UNEXPECTED_EOF);
  SSL_CTX_set_cipher_list(context, "ECDHE+AESGCM:ECDHE+CHACHA20");
  SSL_CTX_set_session_cache_mode(context, SSL_SESS_CACHE_OFF);
  SSL_CTX_set_num_tickets(context, 0);
  SSL_CTX_set_max_cert_list(context, CERTIFICATES_BYTES);
  SSL_CTX_set_verify_depth(context, CHAIN_LENGTH);
  /* a read returns also after a record without content */
  SSL_CTX_clear_mode(context, SSL_MODE_AUTO_RETRY);
  SSL_CTX_set_mode(context, SSL_MODE_ENABLE_PARTIAL_WRITE | SSL_MODE_ACCEPT_MOVING_WRITE_BUFFER |
                                SSL_MODE_RELEASE_BUFFERS);
  SSL_CTX_set_default_passwd_cb(context, no_password);
}

static bool load_client_ca(SSL_CTX *context, const char *path) {
  STACK_OF(X509_NAME) *names = SSL_load_client_CA_file(path);
  if (names == NULL || SSL_CTX_load_verify_file(context, path) != 1) {
    sk_X509_NAME_pop_free(names, X509_NAME_free);
    return false;
  }
  SSL_CTX_set_client_CA_list(context, names);
  SSL_CTX_set_verify(context, SSL_VERIFY_PEER | SSL_VERIFY_FAIL_IF_NO_PEER_CERT, NULL);
  return true;
}

static void free_roles(void *context, void *roles, CRYPTO_EX_DATA *data, int index, long number,
                       void *pointer) {
  (void)context, (void)data, (void)index, (void)number, (void)pointer;
  roles_free(roles);
}

/* Reads the file of roles. If that fails, writes the reason. */
static bool load_roles(SSL_CTX *context, const char *path, char why[TLS_WHY_BYTES]) {
  struct roles *roles = roles_read(path, why, TLS_WHY_BYTES);
  if (roles != NULL && SSL_CTX_set_ex_data(context, roles_index, roles) != 1) {
    roles_free(roles);
    snprintf(why, TLS_WHY_BYTES, "out of memory");
    return false;
  }
  return roles != NULL;
}

/* Reads the files. If that fails, sets *what to the file and why to the reason. */
static SSL_CTX *load(const struct options *options, const char **what, char why[TLS_WHY_BYTES]) {
  ERR_clear_error();
  *what = "TLS";
  SSL_CTX *context = SSL_CTX_new(TLS_server_method());
  bool good = context != NULL, has_password = false;
  if (good) {
    set_manners(context);
    SSL_CTX_set_default_passwd_cb_userdata(context, &has_password);
    *what = options->certificate;
    good = SSL_CTX_use_certificate_chain_file(context, options->certificate) == 1;
  }
  if (good) {
    *what = options->key;
    good = SSL_CTX_use_PrivateKey_file(context, options->key, SSL_FILETYPE_PEM) == 1 &&
           SSL_CTX_check_private_key(context) == 1;
  }
  if (good && options->client_ca != NULL) {
    *what = options->client_ca;
    good = load_client_ca(context, options->client_ca);
  }
  if (has_password) {
    snprintf(why, TLS_WHY_BYTES,
             "the key has a password: give a key without one, as openssl pkey writes it");
  } else if (!good) {
    describe_fault(why);
  } else if (options->roles != NULL) {
    *what = options->roles;
    good = load_roles(context, options->roles, why);
  }
  if (!good) {
    SSL_CTX_free(context);
    return NULL;
  }
  return context;
}

struct tls *tls_new(const struct options *options) {
  const char *what;
  char why[TLS_WHY_BYTES];
  if (options->certificate == NULL || options->key == NULL) {
    fprintf(stderr, "dipoled: %s tls:HOST:PORT needs --certificate FILE and --key FILE\n",
            has_tls(&options->listen) ? "--listen" : "--modbus");
    return NULL;
  }
  if (options->client_ca == NULL && has_tls(&options->modbus)) {
    fprintf(stderr, "dipoled: --modbus tls:HOST:PORT needs --client-ca FILE: masters have to have "
                    "certificates\n");
    return NULL;
  }
  struct tls *tls = calloc(1, sizeof *tls);
  roles_index = SSL_CTX_get_ex_new_index(0, NULL, NULL, NULL, free_roles);
  SSL_CTX *context = load(options, &what, why);
  if (tls == NULL || context == NULL) {
    fprintf(stderr, "dipoled: %s: %s\n", what, context == NULL ? why : "out of memory");
    SSL_CTX_free(context);
    free(tls);
    return NULL;
  }
  tls->options = options;
  tls->context = context;
  return tls;
}

void tls_free(struct tls *tls) {
  if (tls != NULL) {
    SSL_CTX_free(tls->context);
    free(tls);
  }
}

void tls_reload(struct tls *tls) {
  const char *what;
  char why[TLS_WHY_BYTES];
  SSL_CTX *fresh = load(tls->options, &what, why);
  if (fresh == NULL) {
    log_line(LOG_LEVEL_ERROR, "event=tls-not-reloaded%s%s%s%s", LOG_FIELD(" file=", what),
             LOG_FIELD(" reason=", why));
    return;
  }
  SSL_CTX_free(tls->context); /* open sessions keep their own reference */
  tls->context = fresh;
  log_line(LOG_LEVEL_INFO, "event=tls-reloaded%s%s",
           LOG_FIELD(" certificate=", tls->options->certificate));
}

/* ---- sessions -------------------------------------------------------------------------------- */

/* OpenSSL's structure under another name, so that others need not know OpenSSL. */
static SSL *ssl_of(const struct tls_session *session) {
  return (SSL *)(void *)session;
}

struct tls_session *tls_session_new(struct tls *tls, int fd) {
  SSL *ssl = SSL_new(tls->context);
  BIO *arrived = BIO_new(BIO_s_mem());
  if (ssl == NULL || arrived == NULL || SSL_set_wfd(ssl, fd) != 1) {
    BIO_free(arrived);
    SSL_free(ssl);
    ssl = NULL;
  } else {
    SSL_set0_rbio(ssl, arrived);
    SSL_set_accept_state(ssl);
  }
  ERR_clear_error();
  return (struct tls_session *)(void *)ssl;
}

void tls_session_free(struct tls_session *session) {
  SSL_free(ssl_of(session));
}

/* Receives more for OpenSSL, unless it holds something yet. So no call of OpenSSL lasts for as
 * long as the peer sends. Returns false if the socket fails. */
static bool feed(SSL *ssl) {
  char bytes[FEED_BYTES];
  BIO *arrived = SSL_get_rbio(ssl);
  if (BIO_pending(arrived) > 0 || SSL_pending(ssl) > 0) {
    return true;
  }
  const ssize_t got = recv(SSL_get_wfd(ssl), bytes, sizeof bytes, 0);
  if (got == 0) {
    BIO_set_mem_eof_return(arrived, 0); /* reads report the end of the stream, not "try again" */
  }
  return got > 0 ? BIO_write(arrived, bytes, (int)got) == got
                 : got == 0 || errno == EAGAIN || errno == EINTR;
}

enum tls_progress tls_session_shake_hands(struct tls_session *session, char why[TLS_WHY_BYTES]) {
  SSL *ssl = ssl_of(session);
  ERR_clear_error();
  const bool fed = feed(ssl);
  const int result = fed ? SSL_do_handshake(ssl) : 0;
  if (result == 1) {
    return TLS_DONE;
  }
  switch (fed ? SSL_get_error(ssl, result) : SSL_ERROR_SYSCALL) {
  case SSL_ERROR_WANT_READ:
    return TLS_WANTS_READ;
  case SSL_ERROR_WANT_WRITE:
    return TLS_WANTS_WRITE;
  case SSL_ERROR_SSL:
    describe_fault(why);
    if (SSL_get_verify_result(ssl) != X509_V_OK) {
      snprintf(why, TLS_WHY_BYTES, "%s", X509_verify_cert_error_string(SSL_get_verify_result(ssl)));
    }
    return TLS_FAILED;
  default:
    snprintf(why, TLS_WHY_BYTES, "the peer has closed the connection");
    return TLS_FAILED;
  }
}

/* Copies the role of a certificate: "" if there is none, or if it is too long or anything else than
 * one UTF8String in DER. */
static void copy_role(X509 *certificate, char role[ROLE_BYTES]) {
  ASN1_OBJECT *oid = OBJ_txt2obj(ROLE_OID, 1);
  const int at = oid != NULL ? X509_get_ext_by_OBJ(certificate, oid, -1) : -1;
  ASN1_OBJECT_free(oid);
  role[0] = '\0';
  if (at < 0) {
    return;
  }
  const ASN1_OCTET_STRING *value = X509_EXTENSION_get_data(X509_get_ext(certificate, at));
  const unsigned char *const bytes = ASN1_STRING_get0_data(value), *end = bytes;
  ASN1_UTF8STRING *text = d2i_ASN1_UTF8STRING(NULL, &end, ASN1_STRING_length(value));
  const int length = text != NULL ? ASN1_STRING_length(text) : 0;
  /* Below 128 bytes, DER has one byte for the kind and one for the length. */
  _Static_assert(ROLE_BYTES <= 128, "longer ones have a longer length");
  if (length < ROLE_BYTES && text != NULL && bytes[0] == V_ASN1_UTF8STRING &&
      ASN1_STRING_length(value) == length + 2 &&
      memchr(ASN1_STRING_get0_data(text), 0, (size_t)length) == NULL) {
    memcpy(role, ASN1_STRING_get0_data(text), (size_t)length);
    role[length] = '\0';
  }
  ASN1_UTF8STRING_free(text);
}

/* Writes the subject of a certificate (RFC 2253); "" if it is too long. */
static void copy_subject(const X509 *certificate, char subject[SUBJECT_BYTES]) {
  BIO *bio = BIO_new(BIO_s_mem());
  subject[0] = '\0';
  if (bio == NULL) {
    return;
  }
  const int length =
      X509_NAME_print_ex(bio, X509_get_subject_name(certificate), 0, XN_FLAG_RFC2253);
  if (length > 0 && length < SUBJECT_BYTES && BIO_read(bio, subject, length) == length) {
    subject[length] = '\0';
  } else {
    subject[0] = '\0';
  }
  BIO_free(bio);
}

unsigned tls_session_roles(const struct tls_session *session) {
  const SSL *ssl = (const SSL *)(const void *)session;
  const struct roles *roles = SSL_CTX_get_ex_data(SSL_get_SSL_CTX(ssl), roles_index);
  X509 *certificate = SSL_get0_peer_certificate(ssl);
  char subject[SUBJECT_BYTES] = "", role[ROLE_BYTES] = "";
  ERR_clear_error();
  if (roles != NULL && certificate != NULL) {
    copy_subject(certificate, subject);
    copy_role(certificate, role);
  }
  ERR_clear_error();
  return roles != NULL ? roles_of(roles, subject, role) : ROLE_ALL;
}

bool tls_session_is_blocked(const struct tls_session *session) {
  return SSL_want_write(ssl_of(session));
}

/* Frees the memory of bytes that OpenSSL has taken: a silent connection holds little. */
static void release_memory(const SSL *ssl) {
  BUF_MEM *memory, *fresh;
  BIO_get_mem_ptr(SSL_get_rbio(ssl), &memory);
  if (memory->max > KEPT_BYTES && (fresh = BUF_MEM_new()) != NULL) {
    BIO_set_mem_buf(SSL_get_rbio(ssl), fresh, BIO_CLOSE);
  }
}

bool tls_session_holds(const struct tls_session *session) {
  const SSL *ssl = (const SSL *)(const void *)session;
  const bool holds = BIO_pending(SSL_get_rbio(ssl)) > 0 || SSL_has_pending(ssl);
  if (!holds) {
    release_memory(ssl);
  }
  return holds;
}

/* Returns what the failure of a read or a write means. */
static ssize_t outcome(const SSL *ssl, int result) {
  switch (SSL_get_error(ssl, result)) {
  case SSL_ERROR_WANT_READ:
    if (BIO_pending(SSL_get_rbio(ssl)) > 0) {
      return 0;
    }
    release_memory(ssl);
    return UV_EAGAIN;
  case SSL_ERROR_WANT_WRITE:
    return UV_EAGAIN;
  case SSL_ERROR_ZERO_RETURN:
    return UV_EOF;
  default:
    ERR_clear_error();
    return UV_EPROTO;
  }
}

ssize_t tls_session_read(struct tls_session *session, void *to, size_t bytes) {
  SSL *ssl = ssl_of(session);
  ERR_clear_error();
  if (!feed(ssl)) {
    return UV_EPROTO;
  }
  const int got = SSL_read(ssl, to, bytes < INT32_MAX ? (int)bytes : INT32_MAX);
  return got > 0 ? got : outcome(ssl, got);
}

ssize_t tls_session_write(struct tls_session *session, const void *from, size_t bytes) {
  ERR_clear_error();
  const int sent = SSL_write(ssl_of(session), from, bytes < INT32_MAX ? (int)bytes : INT32_MAX);
  return sent > 0 ? sent
         : SSL_want_read(ssl_of(session))
             ? UV_EPROTO /* the stream ends within a message of a handshake */
             : outcome(ssl_of(session), sent);
}

void tls_session_end(struct tls_session *session) {
  ERR_clear_error();
  SSL_shutdown(ssl_of(session));
  ERR_clear_error();
}
