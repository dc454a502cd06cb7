/* @label@: the @model@ model of dlgmd @version@ and its alarm, in @arithmetic@.

   @costs@

   Pass each picture once: repeated frames are not detected. DLGMD_FPS of them a second are best: see
   dlgmd_every, and the step of dlgmd_step for other rates. */
#ifndef DLGMD_H
#define DLGMD_H

#include <stdbool.h>
#include <stdint.h>

/* @sizes@ */

/* Of the ring `change`: rows from one frame to the next, rows in total, and bytes per row. */
#define DLGMD_PERIOD (DLGMD_HEIGHT + DLGMD_RADIUS)
#define DLGMD_ROWS (DLGMD_MAX_DELAY * DLGMD_PERIOD + 2 * DLGMD_RADIUS + 1)
#define DLGMD_STRIDE (DLGMD_WIDTH + DLGMD_MARGIN)
#if DLGMD_EXPANDS
/* The pictures whose expansion is measured are smaller by this factor. */
#define DLGMD_FACTOR (DLGMD_WIDTH < 240 ? 1 : DLGMD_WIDTH / 120)
/* It is measured in windows of so many cells along each side, at most: half of the shorter side. */
#define DLGMD_SHORTER (DLGMD_WIDTH < DLGMD_HEIGHT ? DLGMD_WIDTH : DLGMD_HEIGHT)
#define DLGMD_WINDOW ((DLGMD_SHORTER / DLGMD_FACTOR / 2 + 1) / 2 * 2 + 1)
#endif

#if DLGMD_FIXED
typedef int16_t dlgmd_column;
#if DLGMD_CONTRAST
typedef int32_t dlgmd_sum;
#else
typedef uint16_t dlgmd_sum;
#endif
typedef uint16_t dlgmd_change;
typedef int32_t dlgmd_place;  /* in 1/256 cell */
typedef uint16_t dlgmd_blend; /* a level in 1/256 */
typedef int16_t dlgmd_rest;   /* in 1/32 level */
typedef int64_t dlgmd_motion; /* in 1/2^24: a shift in cells, or a rate per frame or second */
#else
typedef float dlgmd_column;
typedef float dlgmd_sum;
typedef float dlgmd_change;
typedef float dlgmd_place;
typedef float dlgmd_blend;
typedef float dlgmd_rest;
typedef float dlgmd_motion;
#endif

/* The state of the model. It is large: use a static variable, for example. */
typedef struct {
#if DLGMD_EXPANDS
    dlgmd_motion ahead, beside; /* expansion in the middle, and of what moves, per second */
#endif
#if DLGMD_CONTRAST
#if DLGMD_FIXED
#if DLGMD_ADAPTS
    uint64_t mean; /* mean K so far, in the unit of the weights */
#endif
    uint64_t usual; /* mean change so far, summed over the cells, in levels / 128 */
    uint32_t sigma; /* contrast, in levels / 65536 */
    uint32_t noise; /* in levels / 65536 */
    uint32_t interval; /* since the frame before, in 1/2^20 s */
    uint32_t n_usual;  /* the same in frames at the usual rate, in 1/65536 */
#else
#if DLGMD_ADAPTS
    float mean; /* mean K so far */
#endif
    float usual; /* mean change so far, summed over the cells, in levels */
    float sigma; /* contrast, in levels */
    float noise; /* in levels */
    float interval; /* since the frame before, in seconds */
    float n_usual;  /* the same in frames at the usual rate */
#endif
#else
    uint32_t change_sums[DLGMD_FFI_DELAY + 1]; /* of the last frames, newest first, in levels */
#endif
    uint32_t frame;  /* number of frames; it wraps after years, which has the effect of a reset */
    uint32_t start;  /* row of `change` where the zeros above the next frame begin */
    uint32_t spikes; /* consecutive spikes */
#if DLGMD_SHIFT > 0
    int32_t blocks_y, blocks_x; /* how far the picture moved last, in blocks of 4 x 4 cells */
#endif
    union { /* used only during a step */
        struct {
            dlgmd_column columns[DLGMD_COLUMNS][DLGMD_WIDTH + 2 * DLGMD_RADIUS];
#if DLGMD_CONTRAST
            dlgmd_sum s[DLGMD_WIDTH];
#else
            dlgmd_sum s[4][DLGMD_WIDTH + 3]; /* the last rows of S, shifted right by one cell */
#endif
        } rows;
#if DLGMD_CONTRAST
        struct {
            uint32_t all[256];  /* histogram of the change of all cells */
            uint32_t some[256]; /* of the cells that the lower quartile is taken of */
        } counts;
#endif
#if DLGMD_SHIFT > 0
        uint16_t blocks[2][DLGMD_HEIGHT / 4][DLGMD_WIDTH / 4]; /* sums of this frame and the last */
#endif
#if DLGMD_EXPANDS
        struct {
            dlgmd_place parts[DLGMD_WINDOW];              /* where columns have moved to: beyond */
            int16_t cells[DLGMD_WINDOW + 1];              /* these cells; -1 outside the picture */
            dlgmd_rest rests[DLGMD_WINDOW][DLGMD_WINDOW]; /* differences from there */
            dlgmd_blend line[DLGMD_WIDTH / DLGMD_FACTOR];
            uint8_t before[DLGMD_WINDOW + 2][DLGMD_WINDOW + 2];
            uint8_t now[2][DLGMD_WIDTH / DLGMD_FACTOR];
        } fit;
        struct {
            uint8_t now[DLGMD_WIDTH / DLGMD_FACTOR];
            uint8_t change[DLGMD_HEIGHT / DLGMD_FACTOR][DLGMD_WIDTH / DLGMD_FACTOR];
        } moving;
#endif
    } work;
#if DLGMD_CONTRAST
    dlgmd_change passed[DLGMD_MAX_DELAY + 1][256]; /* P' by change, for each frame kept */
#endif
    uint8_t previous[DLGMD_HEIGHT * DLGMD_WIDTH]; /* the frame before */
    /* |L(t) - L(t-1)| of the last frames: a ring of rows, with zeros between frames and rows. The
       first rows are repeated after the last ones, so that neighbouring rows are contiguous. */
    uint8_t change[DLGMD_MARGIN + (DLGMD_ROWS + 2 * DLGMD_RADIUS) * DLGMD_STRIDE];
} dlgmd_state;

/* The answer to one frame. All fields are 0 while `valid` is false, before the history is full. */
typedef struct {
    bool valid;
    bool spike; /* mp_abs reaches the threshold */
    bool alarm; /* enough consecutive spikes: a collision is imminent */
#if DLGMD_FIXED
    uint32_t mp;     /* membrane potential K, in 1/4096 */
    uint16_t mp_abs; /* normalised to 0..1, in 1/32768 */
    int16_t g_x;     /* centroid of G: -1 at the left edge, 1 at the right, in 1/32768 */
    int16_t g_y;     /* -1 at the top edge, 1 at the bottom; both are 0 where G is 0 */
    uint16_t ttc_s;  /* estimated time to contact, in 1/4096 s; 0 where nothing expands */
#else
    float mp;     /* membrane potential K */
    float mp_abs; /* normalised to 0..1 */
    float g_x;    /* centroid of G: -1 at the left edge, 1 at the right */
    float g_y;    /* -1 at the top edge, 1 at the bottom; both are 0 where G is 0 */
    float ttc_s;  /* estimated time to contact in seconds; 0 where nothing expands */
#endif
} dlgmd_answer;

/* Where in the picture the active cells are: thirds across and down, -1, 0 (middle) or 1. */
typedef struct {
    int8_t across; /* -1 left, 1 right */
    int8_t down;   /* -1 high, 1 low */
} dlgmd_side;

static inline dlgmd_side dlgmd_side_of(const dlgmd_answer *answer)
{
#if DLGMD_FIXED
    const int32_t third = 32768 / 3;
    int32_t x = answer->g_x, y = answer->g_y;
#else
    const float third = 1.0f / 3.0f;
    float x = answer->g_x, y = answer->g_y;
#endif
    return (dlgmd_side){(int8_t)((x > third) - (x < -third)), (int8_t)((y > third) - (y < -third))};
}

/* Why pictures show nothing: too little light, too little contrast, nothing but noise, or always the
   same picture. */
typedef enum { DLGMD_SOUND, DLGMD_BLACK, DLGMD_FLAT, DLGMD_NOISE, DLGMD_FROZEN } dlgmd_blind;

/* The state of dlgmd_health. */
#define DLGMD_BLOCKS ((DLGMD_WIDTH / 4) * (DLGMD_HEIGHT / 4))
typedef struct {
    uint32_t now_ms, first_ms;         /* time of the newest picture, and of `first` */
    uint32_t turned_ms, suspected_ms;  /* when pictures turned bad or sound, and `suspected` began */
    int32_t change;                    /* usual change of a block, in levels / 4096 */
    uint32_t n_seen;                   /* pictures so far, at most 2 */
    dlgmd_blind suspected, reason;
    uint16_t now[DLGMD_BLOCKS];    /* sums over 4 x 4 cells of the newest picture */
    uint16_t before[DLGMD_BLOCKS]; /* of the one before */
    uint16_t first[DLGMD_BLOCKS];  /* of the first one that the newest is the same as */
} dlgmd_sight;

/* For a camera of `fps` frames a second: pass every how many-th of them, as Python does, or 0 where
   it is too slow for the model: under four fifths of DLGMD_FPS. */
static inline uint32_t dlgmd_every(uint32_t fps)
{
    const uint32_t most = 11u * (uint32_t)DLGMD_FPS; /* a tenth more is as good */
    return 5u * fps < 4u * (uint32_t)DLGMD_FPS ? 0u : (10u * fps + most - 1u) / most;
}

/* Start anew. Call this before the first frame, and after missing frames. */
void dlgmd_reset(dlgmd_state *state);

/* Process the next frame: grey levels, row by row, from the top left corner. `step_ms` is the time
   since the frame before in milliseconds, at most 1000; 0 is 1 / DLGMD_FPS.
   @timed@ */
dlgmd_answer dlgmd_step(dlgmd_state *state, const uint8_t *frame, uint32_t step_ms);

/* In dlgmd_health.c, which a project needs for these only. Start anew. */
void dlgmd_health_reset(dlgmd_sight *sight);

/* Whether the pictures show what the model needs: DLGMD_SOUND, or why they have not for 0.7 s. Pass
   every picture of the camera, repeated ones too, with its step as above. It is sound again after half
   a second. No alarm is no all-clear while it is not; an alarm still is one. */
dlgmd_blind dlgmd_health(dlgmd_sight *sight, const uint8_t *frame, uint32_t step_ms);

#endif
