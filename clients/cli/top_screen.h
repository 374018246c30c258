/* top_screen: the terminal on which `dipole top` shows its table again and again in one place. */
#ifndef DIPOLE_CLI_TOP_SCREEN_H
#define DIPOLE_CLI_TOP_SCREEN_H

#include <stdbool.h>

#include "clients/cli/top_record.h"

/* Takes the screen if standard output is a terminal. */
void top_screen_begin(void);
bool top_screen_is_on(void);

void top_screen_show(const dipole_info *info, const top_record *record);

/* Gives the terminal back as it was, with the last table; may be called by a signal's handler, and
 * without a screen. */
void top_screen_restore(void);

#endif
