/* page: draws a figure as an SVG page with a panel for each medium and a legend. */
#ifndef FIGURES_PAGE_H
#define FIGURES_PAGE_H

#include "core/tools/figures/panel.h"

enum { PAGE_COLUMNS = 4, PAGE_ROWS = 3, PAGE_PANELS_MAX = PAGE_COLUMNS * PAGE_ROWS - 1 };

/* LOGARITHMIC draws R over r with logarithmic axes. GAMMA draws R^(1 / 2.2), which is roughly the
 * brightness on a screen, over r with linear axes. */
enum page_form { PAGE_LOGARITHMIC, PAGE_GAMMA, PAGE_FORMS };

/* The curves of a page: the models of Figures 1 to 16, or the dipole's switches of Figure 17. */
enum page_subject { PAGE_MODELS, PAGE_SWITCHES };

typedef struct page_layout {
  const char *title;
  enum page_subject subject;
  size_t count; /* 1 to PAGE_PANELS_MAX */
  const panel_data *panels[PAGE_PANELS_MAX];
  size_t cell[PAGE_PANELS_MAX]; /* cell of each panel, row by row; the legend has the last cell */
} page_layout;

/* Names of the forms, which are part of the pages' file names. */
extern const char *const page_form_names[PAGE_FORMS];

void page_draw(const page_layout *page, enum page_form form, const char *path);

#endif
