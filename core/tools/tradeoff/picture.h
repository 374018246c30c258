/* picture: a gnuplot script, drawn as SVG and as PNG. */
#ifndef TRADEOFF_PICTURE_H
#define TRADEOFF_PICTURE_H

#include <stdio.h>

/* Draws <path>.svg and <path>.png, width by height pixels; put(script, context) writes the script
 * but for its terminal, the same for both. */
void picture_draw(const char *path, unsigned width, unsigned height,
                  void (*put)(FILE *script, const void *context), const void *context);

#endif
