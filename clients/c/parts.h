/* parts: puts the parts of an answer together. All replies in parts begin with a wire_part; what
 * follows is as messages.def says. */
#ifndef LIBDIPOLE_PARTS_H
#define LIBDIPOLE_PARTS_H

#include "clients/c/request.h"

/* Returns whether a reply is the next part of the answer to a request, with a count that it may
 * have. */
bool libdipole_part_is_next(const libdipole_pending *pending, const wire_part *part);

/* Takes a part of an answer, a frame, which it owns. After the last one, the whole answer is
 * pending->frame, as if it had come in one part. Fails with kind PROTOCOL if the part does not
 * belong to the request or to the parts before it. */
bool libdipole_part_take(libdipole_pending *pending, libdipole_frame *frame, dipole_error *error);

/* Throws away the parts of an answer that have come. */
void libdipole_parts_drop(libdipole_pending *pending);

#endif
