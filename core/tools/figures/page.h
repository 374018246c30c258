/* page: a figure as an SVG page: a panel for each medium, and a legend. */
#ifndef FIGURES_PAGE_H
#define FIGURES_PAGE_H

#include "core/tools/figures/panel.h"

enum { PAGE_COLUMNS = 4, PAGE_ROWS = 3, PAGE_PANELS_MAX = PAGE_COLUMNS * PAGE_ROWS - 1 };

/* logarithmic: both axes; gamma: R to the power 1 / 2.2, roughly as bright as a screen shows it,
 * over r, both axes linear. */
enum page_form { PAGE_LOGARITHMIC, PAGE_GAMMA, PAGE_FORMS };

/* Which curves: those of Figures 1 to 16, or the dipole's switches of Figure 17. */
enum page_subject { PAGE_MODELS, PAGE_SWITCHES };

typedef struct page_layout {
  const char *title;
  enum page_subject subject;
  size_t count; /* 1 to PAGE_PANELS_MAX */
  const panel_data *panels[PAGE_PANELS_MAX];
  size_t cell[PAGE_PANELS_MAX]; /* where, row by row; the last cell is the legend's */
} page_layout;

/* The ending of the page's file, and of one that is meant for people. */
extern const char *const page_form_names[PAGE_FORMS];

void page_draw(const page_layout *page, enum page_form form, const char *path);

#endif
