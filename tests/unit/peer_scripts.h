/* peer_scripts: the parts that tests of the client library share: scripts for peers, clients that
 * are connected to a peer, and queries whose answers can be checked. */
#ifndef DIPOLED_TESTS_PEER_SCRIPTS_H
#define DIPOLED_TESTS_PEER_SCRIPTS_H

#include "tests/unit/scripted_peer.h"

typedef void peer_script(int fd, void *context);

/* Steps of scripts. They abort the program if the other side does not do what it should. */
void peer_receive_or_abort(int fd, peer_frame *request);
void peer_say_hello_or_abort(int fd);
void peer_send_error(int fd, uint64_t id, enum wire_status status, uint32_t retry_after_ms);
void peer_answer(int fd, const peer_frame *request);

/* Returns how many parts of `each` radii, or fewer in the last one, answer an eval request. */
uint32_t peer_parts_of(const peer_frame *request, uint64_t each);

/* Sends one of these parts. Returns false if the client is gone. */
bool peer_send_part(int fd, const peer_frame *request, uint32_t part, uint64_t each);

/* Makes the frame that answers a request, *count bytes, which the caller frees. The bytes of its
 * payload from position `garbled` on are overwritten with 0xff. */
uint8_t *peer_make_answer(const peer_frame *request, size_t garbled, size_t *count);

/* Scripts: each closes the connection at its end. */
peer_script peer_hang_up_at_once, peer_hang_up_after_hello, peer_hang_up_after_request;
peer_script
    peer_hang_up_in_answer;   /* of which it sends as many bytes as the size_t *context says */
peer_script peer_serve_parts; /* answers in parts of as many radii as the uint64_t *context says */
peer_script peer_be_full;     /* refuses the connection for the next 30 ms */

/* ---- clients ------------------------------------------------------------------------------- */

enum { PEER_PATIENCE_MS = 20000 }; /* a test that would hang fails after this */

/* Returns the default options, with PEER_PATIENCE_MS for connecting, waiting and trying again. */
dipole_options peer_options(void);

/* Opens a client. options: NULL means peer_options(). Fails the test if the client does not open.
 */
dipole_client *peer_open(const char *address, const dipole_options *options);

/* The peer of a test that has one. The next three functions start it and open a client. */
extern scripted_peer peer_of_test;

/* Without retries, so that the test sees each failure. */
dipole_client *peer_begin(peer_script *script, void *context);

/* With options like peer_open(). */
dipole_client *peer_begin_with(peer_script *script, void *context, const dipole_options *options);

/* With one script for each connection, and retries. */
dipole_client *peer_begin_scripts(peer_script *const *scripts, void *context);

/* Closes the client and waits for the peer's script to end. */
void peer_finish(dipole_client *client);

/* Fails the test with the error's text unless a call was good. */
void peer_expect(bool good, const dipole_error *error);

/* Evaluates a query. The caller frees the result. Fails the test if there is none. */
dipole_result *peer_eval(dipole_client *client, const dipole_query *query);

/* Returns the addresses as one text, "A,B,...", which the caller frees. */
char *peer_list(const char *const *addresses, size_t count);

int64_t peer_now_ms(void);

/* ---- queries ------------------------------------------------------------------------------- */

enum { PEER_RADII = 1000 };

/* Radius i is i / 8 mm. Call peer_make_radii() before you use these arrays. */
extern double peer_radii_f64[PEER_RADII];
extern float peer_radii_f32[PEER_RADII];
void peer_make_radii(void);

extern const dipole_medium peer_media[2];

/* Returns a query for R and the albedo of the first medium at the first `count` radii. The tests
 * give each query another count, so that an answer to a wrong query is noticed. */
dipole_query peer_query(uint64_t count);

/* Checks that a result is the answer of peer_serve() to peer_query(count), and frees it. */
void peer_check_result(dipole_result *result, uint64_t count);

/* Evaluates peer_query(count) and checks the result. */
void peer_check_eval(dipole_client *client, uint64_t count);

/* Evaluates a query of 5 radii, which must fail with an error of this kind. */
dipole_error peer_check_failure(dipole_client *client, enum dipole_error_kind kind);

/* Submits peer_query(count) and returns the request's id. */
uint64_t peer_submit(dipole_client *client, uint64_t count);

/* Submits peer_query(1) to peer_query(count), collects the answers in any order, and checks that each
 * query has exactly one, the right one. */
void peer_check_each(dipole_client *client, uint64_t count);

/* Scripts that receive until the client ends. peer_accept_only() answers nothing, and
 * peer_be_silent() answers only hello. */
peer_script peer_accept_only, peer_be_silent;

/* Scripts: one refuses every request with BUSY for as long as the uint32_t *context says, in ms; one
 * answers seven requests. */
peer_script peer_stay_busy, peer_answer_seven;

/* A script that aborts. Use it for a connection that must not be made. */
peer_script peer_must_not_come;

/* A script that says hello with other lists than peer_say_hello(). */
peer_script peer_serve_other_lists;

#endif
