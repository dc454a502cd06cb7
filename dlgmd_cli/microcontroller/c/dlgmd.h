/* @label@: the @model@ model of dlgmd @version@, the expansion and the alarm, in single precision.

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

/* Whether bands of mains light are removed from what is measured. */
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
/* By so many frames. */
#define DLGMD_KEPT 6

/* What ttc_s is where nothing expands. */
#define DLGMD_NO_TTC INFINITY

/* A place in an image, or how far it is from another one, in px. */
typedef struct {
    float x, y;
} dlgmd_place;

/* A part of an image, in px. */
typedef struct {
    float top, bottom, left, right;
} dlgmd_window;

#if DLGMD_EXPANSION
/* What is needed to follow points from one image to another. */
typedef struct {
    dlgmd_place places[DLGMD_POINTS], moves[DLGMD_POINTS]; /* of points that were found */
    float weights[DLGMD_POINTS], squares[DLGMD_POINTS], sorted[DLGMD_POINTS]; /* of the fit */
    /* Of the patch around a point: its cells and their slopes, and these at the point's fraction. */
    int16_t cells[DLGMD_PATCH + 1][DLGMD_PATCH + 1];
    int16_t slopes_x[DLGMD_PATCH + 1][DLGMD_PATCH + 1];
    int16_t slopes_y[DLGMD_PATCH + 1][DLGMD_PATCH + 1];
    int16_t levels[DLGMD_PATCH][DLGMD_PATCH];
    int16_t right[DLGMD_PATCH][DLGMD_PATCH], down[DLGMD_PATCH][DLGMD_PATCH];
    uint16_t sums[DLGMD_WIDTH + 4];
    uint8_t row[DLGMD_WIDTH + 4];
    uint8_t around[DLGMD_PATCH + 3][DLGMD_PATCH + 3];
    uint8_t pyramids[2][DLGMD_LEVEL_CELLS]; /* smaller images of an earlier frame and of this */
} dlgmd_track;
#endif

/* The state of the model. It is large: use a static variable, for example. */
typedef struct {
    uint32_t change_sums[DLGMD_FFI_DELAY + 1]; /* of the last frames, newest first, in levels */
    uint32_t frame;  /* number of frames; it wraps after years, which has the effect of a reset */
    uint32_t start;  /* row of `change` where the zeros above the next frame begin */
    uint32_t spikes; /* consecutive spikes */
#if DLGMD_EXPANSION
    float weight, sum;   /* of rates ahead by their precision, and of those times the rates */
    float upright, age;  /* the same sums of the rates of what stands upright, and of the ages */
    float low_s;         /* how long the quality has been low; 0: it is not */
    dlgmd_window window; /* ahead */
    uint32_t steps_us[DLGMD_EARLIER]; /* from the frame before to each of `frames` */
#if DLGMD_EVENS
    float row_changes[DLGMD_KEPT]; /* mean change of the rows after so many frames, in levels */
    uint32_t n_changes;
    float gains[DLGMD_EARLIER + 1][DLGMD_HEIGHT]; /* of rows; the first is 0 in steady light */
    uint16_t row_sums[DLGMD_KEPT][DLGMD_HEIGHT];  /* of the last frames: a ring */
#endif
    union { /* used only during a step; each member is written before it is read */
#else
    struct { /* used only during a step */
#endif
        struct {
            float columns[DLGMD_COLUMNS][DLGMD_WIDTH + 2 * DLGMD_RADIUS];
            float s[4][DLGMD_WIDTH + 3]; /* the last rows of S, shifted right by one cell */
        } rows;
#if DLGMD_EXPANSION
        dlgmd_track track;
#endif
    } work;
    uint8_t frames[DLGMD_EARLIER][DLGMD_HEIGHT * DLGMD_WIDTH]; /* the frames before: a ring */
    /* |L(t) - L(t-1)| of the last frames: a ring of rows, with zeros between frames and rows. The
       first rows are repeated after the last ones, so that neighbouring rows are contiguous. */
    uint8_t change[DLGMD_MARGIN + (DLGMD_ROWS + 2 * DLGMD_RADIUS) * DLGMD_STRIDE];
} dlgmd_state;

/* The answer to one frame. */
typedef struct {
    bool valid; /* the history of the neuron is full; before that, its answer is 0 */
    bool spike; /* mp_abs reaches the threshold */
    bool alarm; /* a collision is imminent */
    uint8_t rule; /* what raises the alarm: DLGMD_SPIKES, DLGMD_TTC or DLGMD_AHEAD */
    bool has_ttc; /* something expands, so that ttc_s is known */
    /* The rule needs an expansion that could not be measured lately: a collision would raise no alarm. */
    bool unmeasured;
    float mp;     /* membrane potential K */
    float mp_abs; /* normalised to 0..1 */
    /* Centroid of the active cells, 0 without any: -1 at the left or top edge, 1 at the other. */
    float g_x, g_y;
    /* Beside the neuron; 0 where it is not measured. */
    float expansion;         /* ahead, per second; negative: the image shrinks */
    float expansion_upright; /* the same of what stands upright: less over level ground */
    float expansion_quality; /* how well the window was tracked, 0 to 1 */
    float ttc_s; /* estimated time to contact in seconds; DLGMD_NO_TTC unless has_ttc */
    float expansion_x, expansion_y; /* centre of the part that expands */
} dlgmd_answer;

/* Where in the image that is what raises the alarm: thirds across and down, -1, 0 (middle) or 1. */
typedef struct {
    bool known;    /* some cell is active, or something expands, by the rule */
    int8_t across; /* -1 left, 1 right */
    int8_t down;   /* -1 high, 1 low */
} dlgmd_side;

static inline int8_t dlgmd_third(float place)
{
    return (int8_t)((3.0f * place > 1.0f) - (3.0f * place < -1.0f));
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
   same image; and that the expansion is not measured, see dlgmd_blind_of. */
typedef enum {
    DLGMD_SOUND,
    DLGMD_BLACK,
    DLGMD_FLAT,
    DLGMD_NOISE,
    DLGMD_FROZEN,
    DLGMD_UNMEASURED
} dlgmd_blind;

/* Why a collision would raise no alarm, by what dlgmd_health_us says, and by the answer. */
static inline dlgmd_blind dlgmd_blind_of(dlgmd_blind health, const dlgmd_answer *answer)
{
    return health == DLGMD_SOUND && answer->unmeasured ? DLGMD_UNMEASURED : health;
}

/* The state of dlgmd_health_us. */
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
   a second. While it is not, a collision may raise no alarm; an alarm still is one. */
dlgmd_blind dlgmd_health_us(dlgmd_sight *sight, const uint8_t *frame, uint32_t step_us);

#ifdef __cplusplus
}
#endif

#endif
