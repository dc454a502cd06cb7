/* @label@: the @model@ model of dlgmd @version@, the expansion and the alarm, in @arithmetic@.

   @costs@

   Pass each image once: duplicate frames are not detected. DLGMD_FPS of them a second are best: see
   dlgmd_every, and the step of dlgmd_step_us for other rates. */
#ifndef DLGMD_H
#define DLGMD_H

#include <math.h>
#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* @sizes@ */

/* Of the ring `change`: rows from one frame to the next, rows in total, and bytes per row. */
#define DLGMD_PERIOD (DLGMD_HEIGHT + DLGMD_RADIUS)
#define DLGMD_ROWS (DLGMD_MAX_DELAY * DLGMD_PERIOD + 2 * DLGMD_RADIUS + 1)
#define DLGMD_STRIDE (DLGMD_WIDTH + DLGMD_MARGIN)
/* What raises the alarm: spikes in a row, a short time to contact, or an expansion ahead. */
#define DLGMD_SPIKES 0
#define DLGMD_TTC 1
#define DLGMD_AHEAD 2

/* Whether the expansion is measured. Define it as 1 to have it beside the alarm of spikes, too. */
#ifndef DLGMD_EXPANSION
#define DLGMD_EXPANSION (DLGMD_RULE != DLGMD_SPIKES)
#endif

/* Whether bands of mains light and steps of the exposure are removed from what is measured. */
#ifndef DLGMD_DEFLICKER
#define DLGMD_DEFLICKER 1
#endif
#define DLGMD_EVENS (DLGMD_EXPANSION && DLGMD_DEFLICKER)

/* How many frames are kept to compare with. Images less than 27 ms apart change too little to measure
   it, so that Python takes an earlier one: define it as 2 for up to 60 frames a second, and as 4 for
   up to 120. */
#ifndef DLGMD_EARLIER
#define DLGMD_EARLIER 1
#endif
/* By frames kept for the former, and blocks down and across that the latter are seen in. */
#define DLGMD_KEPT 6
#define DLGMD_GRID_Y 8
#define DLGMD_GRID_X 15

#define DLGMD_SHORTER (DLGMD_WIDTH < DLGMD_HEIGHT ? DLGMD_WIDTH : DLGMD_HEIGHT)

#if DLGMD_FIXED
typedef int16_t dlgmd_column;
typedef uint16_t dlgmd_sum;
typedef int32_t dlgmd_place;  /* in 1/256 cell */
typedef uint16_t dlgmd_blend; /* a level in 1/256 */
typedef int16_t dlgmd_rest;   /* in 1/32 level */
typedef int64_t dlgmd_motion; /* in 1/2^24: a shift in cells, or a rate per frame or second */
typedef uint32_t dlgmd_potential;
typedef uint16_t dlgmd_positive;
typedef int16_t dlgmd_signed;
/* What 1 is in an answer: of mp; of mp_abs and of places; of expansion; of ttc_s. */
#define DLGMD_MP_ONE 4096
#define DLGMD_ONE 32768
#define DLGMD_RATE_ONE 1024
#define DLGMD_S_ONE 4096
/* What ttc_s is where nothing expands: longer than any other. */
#define DLGMD_NO_TTC UINT16_MAX
#else
typedef float dlgmd_column;
typedef float dlgmd_sum;
typedef float dlgmd_place;
typedef float dlgmd_blend;
typedef float dlgmd_rest;
typedef float dlgmd_motion;
typedef float dlgmd_potential;
typedef float dlgmd_positive;
typedef float dlgmd_signed;
#define DLGMD_MP_ONE 1
#define DLGMD_ONE 1
#define DLGMD_RATE_ONE 1
#define DLGMD_S_ONE 1
#define DLGMD_NO_TTC INFINITY
#endif

/* A part of an image: rows and columns; those of `bottom` and `right` are excluded. */
typedef struct {
    int32_t top, bottom, left, right;
} dlgmd_window;

/* The state of the model. It is large: use a static variable, for example. */
typedef struct {
    uint32_t change_sums[DLGMD_FFI_DELAY + 1]; /* of the last frames, newest first, in levels */
    uint32_t frame;  /* number of frames; it wraps after years, which has the effect of a reset */
    uint32_t start;  /* row of `change` where the zeros above the next frame begin */
    uint32_t spikes; /* consecutive spikes */
#if DLGMD_EXPANSION
    dlgmd_motion ahead, beside;    /* expansion in the square, and of what moves, per second */
    dlgmd_motion share;            /* of the change in the square that the former explains */
    dlgmd_motion both[2];          /* expansion in the square and in the narrow window */
    dlgmd_window windows[2];       /* those, in the reduced image */
    dlgmd_signed place_x, place_y; /* of what moves */
    int32_t blocks_y, blocks_x;    /* how far the image moved last, in blocks of 4 x 4 cells */
    uint32_t steps_us[DLGMD_EARLIER]; /* from the frame before to each of `frames` */
#if DLGMD_EVENS
    uint32_t row_changes[DLGMD_KEPT]; /* mean change of the rows after so many frames, in 1/16 */
    uint32_t n_changes;
    /* Of the rows of this frame and the kept ones, in 1/2^22; the first is 0 in steady light. */
    uint32_t gains[DLGMD_EARLIER + 1][DLGMD_HEIGHT];
    bool has_stepped;
    uint8_t lit[3][DLGMD_FACTOR * DLGMD_WIDTH];   /* rows of a frame in steady light */
    uint16_t row_sums[DLGMD_KEPT][DLGMD_HEIGHT]; /* of the last frames: a ring */
#endif
    union { /* used only during a step; each member is written before it is read */
#else
    struct { /* used only during a step */
#endif
        struct {
            dlgmd_column columns[DLGMD_COLUMNS][DLGMD_WIDTH + 2 * DLGMD_RADIUS];
            dlgmd_sum s[4][DLGMD_WIDTH + 3]; /* the last rows of S, shifted right by one cell */
        } rows;
#if DLGMD_EXPANSION
        uint16_t blocks[2][DLGMD_HEIGHT / 4][DLGMD_WIDTH / 4]; /* sums of an earlier frame and this */
        struct {
            dlgmd_place parts[DLGMD_WINDOW_X];                /* where columns have moved to: */
            int16_t cells[DLGMD_WINDOW_X + 1];                /* beyond these cells; -1 outside */
            dlgmd_rest rests[DLGMD_WINDOW_Y][DLGMD_WINDOW_X]; /* differences from there */
            dlgmd_blend line[DLGMD_WIDTH / DLGMD_FACTOR];
            uint8_t before[DLGMD_WINDOW_Y + 2][DLGMD_WINDOW_X + 2];
            uint8_t now[2][DLGMD_WIDTH / DLGMD_FACTOR];
        } fit;
        struct {
            uint8_t now[DLGMD_WIDTH / DLGMD_FACTOR];
            uint8_t change[DLGMD_HEIGHT / DLGMD_FACTOR][DLGMD_WIDTH / DLGMD_FACTOR];
        } moving;
#if DLGMD_EVENS
        struct {
            uint32_t before[DLGMD_GRID_Y + 1][DLGMD_GRID_X], now[DLGMD_GRID_Y + 1][DLGMD_GRID_X];
            uint32_t ratios[DLGMD_GRID_Y * DLGMD_GRID_X];
            uint8_t row[DLGMD_WIDTH / DLGMD_FACTOR];
        } grid;
#endif
#endif
    } work;
    uint8_t frames[DLGMD_EARLIER][DLGMD_HEIGHT * DLGMD_WIDTH]; /* the frames before: a ring */
    /* |L(t) - L(t-1)| of the last frames: a ring of rows, with zeros between frames and rows. The
       first rows are repeated after the last ones, so that neighbouring rows are contiguous. */
    uint8_t change[DLGMD_MARGIN + (DLGMD_ROWS + 2 * DLGMD_RADIUS) * DLGMD_STRIDE];
} dlgmd_state;

/* The answer to one frame. Integers are in units of 1 / DLGMD_MP_ONE and so on. */
typedef struct {
    bool valid; /* the history of the neuron is full; before that, its answer is 0 */
    bool spike; /* mp_abs reaches the threshold */
    bool alarm; /* a collision is imminent */
    uint8_t rule; /* what raises the alarm: DLGMD_SPIKES, DLGMD_TTC or DLGMD_AHEAD */
    bool has_ttc; /* something expands, so that ttc_s is known */
    dlgmd_potential mp;    /* membrane potential K */
    dlgmd_positive mp_abs; /* normalised to 0..1 */
    /* Centroid of the active cells, 0 without any: -1 at the left or top edge, 1 at the other. */
    dlgmd_signed g_x, g_y;
    /* Beside the neuron; the rate and the centre are 0 where it is not measured. */
    dlgmd_signed expansion; /* ahead, per second, of both windows; negative: the image shrinks */
    dlgmd_positive ttc_s; /* estimated time to contact in seconds; DLGMD_NO_TTC unless has_ttc */
    dlgmd_signed expansion_x, expansion_y; /* centre of the part that expands */
    dlgmd_signed approach; /* expansion per second of what approaches a camera at rest, else 0 */
} dlgmd_answer;

/* Where in the image that is what raises the alarm: thirds across and down, -1, 0 (middle) or 1. */
typedef struct {
    bool known;    /* some cell is active, or something expands, by the rule */
    int8_t across; /* -1 left, 1 right */
    int8_t down;   /* -1 high, 1 low */
} dlgmd_side;

static inline int8_t dlgmd_third(dlgmd_signed place)
{
    return (int8_t)((3 * place > DLGMD_ONE) - (3 * place < -DLGMD_ONE));
}

static inline dlgmd_side dlgmd_side_of(const dlgmd_answer *answer)
{
    dlgmd_side side;
    bool by_cells = answer->rule == DLGMD_SPIKES;
    side.known = by_cells ? answer->mp > 0 : answer->has_ttc || answer->expansion > 0;
    side.across = dlgmd_third(by_cells ? answer->g_x : answer->expansion_x);
    side.down = dlgmd_third(by_cells ? answer->g_y : answer->expansion_y);
    return side;
}

/* Why images show nothing: too little light, too little contrast, nothing but noise, or always the
   same image. */
typedef enum { DLGMD_SOUND, DLGMD_BLACK, DLGMD_FLAT, DLGMD_NOISE, DLGMD_FROZEN } dlgmd_blind;

/* The state of dlgmd_health. */
#define DLGMD_BLOCKS ((DLGMD_WIDTH / 4) * (DLGMD_HEIGHT / 4))
typedef struct {
    uint32_t now_ms, first_ms;         /* time of the newest image, and of `first` */
    uint32_t turned_ms, suspected_ms;  /* when images turned bad or sound, and `suspected` began */
    int32_t change;                    /* usual change of a block, in levels / 4096 */
    uint32_t n_seen;                   /* images so far, at most 2 */
    uint32_t rest_us;                  /* of the time, less than a millisecond */
    dlgmd_blind suspected, reason;
    uint16_t now[DLGMD_BLOCKS];    /* sums over 4 x 4 cells of the newest image */
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

/* Start anew, with the usual heading. Call this before the first frame, and after missing frames. */
void dlgmd_reset(dlgmd_state *state);

#if DLGMD_EXPANSION
/* Measure the expansion around where the drone flies to, from now on: to the right and upwards of
   the optical axis, in 1/100 degree. Where a window would leave the image, as with 18000, it is
   measured around the usual heading: DLGMD_AHEAD_CDEG upwards. */
void dlgmd_heading(dlgmd_state *state, int32_t right_cdeg, int32_t up_cdeg);
#endif

/* Process the next frame: grey levels, row by row, from the top left corner. `step_us` is the time
   since the frame before in microseconds; 0 is 1/30 s, and what is below 1 ms or above 1 s counts
   as that. The expansion takes it; the neuron counts frames. */
dlgmd_answer dlgmd_step_us(dlgmd_state *state, const uint8_t *frame, uint32_t step_us);

/* In dlgmd_health.c, which a project needs for these only. Start anew. */
void dlgmd_health_reset(dlgmd_sight *sight);

/* Whether the images show what the model needs: DLGMD_SOUND, or why they have not for 0.7 s. Pass
   every image of the camera, duplicates too, with its step as above. It is sound again after half
   a second. No alarm is no all-clear while it is not; an alarm still is one. */
dlgmd_blind dlgmd_health_us(dlgmd_sight *sight, const uint8_t *frame, uint32_t step_us);

#ifdef __cplusplus
}
#endif

#endif
