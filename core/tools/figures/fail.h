/* fail: how a program ends when it cannot go on. */
#ifndef FIGURES_FAIL_H
#define FIGURES_FAIL_H

/* Prints the program's name and a message to standard error, and exits with EXIT_FAILURE. */
_Noreturn void fail(const char *format, ...) __attribute__((format(printf, 1, 2)));

#endif
