/* peer_scripts: what scripted peers do in several tests of the client library. */
#ifndef DIPOLED_TESTS_PEER_SCRIPTS_H
#define DIPOLED_TESTS_PEER_SCRIPTS_H

#include "tests/unit/scripted_peer.h"

typedef void peer_script(int fd, void *context);

/* Steps of scripts. They end the program where the other side does not do what it should. */
void peer_receive_or_abort(int fd, peer_frame *request);
void peer_say_hello_or_abort(int fd);
void peer_send_error(int fd, uint64_t id, enum wire_status status, uint32_t retry_after_ms);
void peer_answer(int fd, const peer_frame *request);

/* Scripts: each closes the connection at its end. */
peer_script peer_hang_up_at_once, peer_hang_up_after_hello, peer_hang_up_after_request;
peer_script
    peer_hang_up_in_answer; /* of which it sends as many bytes as the size_t *context says */
peer_script peer_be_full;   /* refuses the connection for the next 30 ms */

#endif
