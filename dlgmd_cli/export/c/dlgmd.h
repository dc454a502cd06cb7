/* @label@: the @model@ model of dlgmd @version@ and its alarm, in @arithmetic@.

   @costs@

   Show it each picture once: it does not notice frames that merely repeat the one before. */
#ifndef DLGMD_H
#define DLGMD_H

#include <stdbool.h>
#include <stdint.h>

/* @sizes@ */

/* Rows from one frame to the next in `change`; rows that are kept; and their length in bytes. */
#define DLGMD_PERIOD (DLGMD_HEIGHT + DLGMD_RADIUS)
#define DLGMD_ROWS (DLGMD_MAX_DELAY * DLGMD_PERIOD + 2 * DLGMD_RADIUS + 1)
#define DLGMD_STRIDE (DLGMD_WIDTH + DLGMD_MARGIN)

#if DLGMD_FIXED
typedef int16_t dlgmd_column;
#if DLGMD_CONTRAST
typedef int32_t dlgmd_sum;
#else
typedef uint16_t dlgmd_sum;
#endif
typedef uint16_t dlgmd_change;
#else
typedef float dlgmd_column;
typedef float dlgmd_sum;
typedef float dlgmd_change;
#endif

/* What the model remembers. Place it where there is room, for example in a static variable. */
typedef struct {
#if DLGMD_CONTRAST
#if DLGMD_FIXED
    uint64_t usual; /* mean change so far, summed over the cells, in levels / 128 */
    uint32_t sigma; /* contrast, in levels / 65536 */
    uint32_t noise; /* in levels / 65536 */
#else
    float usual; /* mean change so far, summed over the cells, in levels */
    float sigma; /* contrast, in levels */
    float noise; /* in levels */
#endif
#else
    uint32_t change_sums[DLGMD_FFI_DELAY + 1]; /* of the last frames, newest first, in levels */
#endif
    uint32_t frame;  /* frames seen; after four years it wraps, which is like a reset */
    uint32_t start;  /* the row of `change` that the zeros above the next frame begin at */
    uint32_t spikes; /* spikes in a row */
    union { /* memory for the time of a step */
        struct {
            dlgmd_column columns[DLGMD_COLUMNS][DLGMD_WIDTH + 2 * DLGMD_RADIUS];
#if DLGMD_CONTRAST
            dlgmd_sum s[DLGMD_WIDTH];
#else
            dlgmd_sum s[4][DLGMD_WIDTH + 3]; /* the last rows of S, one cell from the left */
#endif
        } rows;
#if DLGMD_CONTRAST
        struct {
            uint32_t all[256];  /* cells by how much they changed */
            uint32_t some[256]; /* those that the lower quartile is taken over */
        } counts;
#endif
    } work;
#if DLGMD_CONTRAST
    dlgmd_change passed[DLGMD_MAX_DELAY + 1][256]; /* P' by change, for each frame kept */
#endif
    uint8_t previous[DLGMD_HEIGHT * DLGMD_WIDTH]; /* the frame before */
    /* |L(t) - L(t-1)| of the last frames: a ring of rows, with zeros between frames and rows. Its
       first rows stand behind the last ones again, so that neighbouring rows are neighbours. */
    uint8_t change[DLGMD_MARGIN + (DLGMD_ROWS + 2 * DLGMD_RADIUS) * DLGMD_STRIDE];
} dlgmd_state;

/* The answer to one frame. All fields are 0 while `valid` is false: the history is not full yet. */
typedef struct {
    bool valid;
    bool spike; /* mp_abs reaches the threshold */
    bool alarm; /* enough spikes in a row: something is about to hit the camera */
#if DLGMD_FIXED
    uint32_t mp;     /* membrane potential K, in 1/4096 */
    uint16_t mp_abs; /* normalised to 0..1, in 1/32768 */
    int16_t g_x;     /* centroid of G: -1 at the left edge, 1 at the right, in 1/32768 */
    int16_t g_y;     /* the same, from the top down; both are 0 where mp is 0 */
#else
    float mp;     /* membrane potential K */
    float mp_abs; /* normalised to 0..1 */
    float g_x;    /* centroid of G: -1 at the left edge, 1 at the right */
    float g_y;    /* the same, from the top down; both are 0 where mp is 0 */
#endif
} dlgmd_answer;

/* Forget all frames. Call it before the first frame, and where frames are missing. */
void dlgmd_reset(dlgmd_state *state);

/* Take the next frame, rows of grey levels from the top left corner on, and answer to it. */
dlgmd_answer dlgmd_step(dlgmd_state *state, const uint8_t *frame);

#endif
