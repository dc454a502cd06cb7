/* The model, the expansion and the alarm; see dlgmd.h. Constants and sums are in dlgmd_model.h. */
#include "dlgmd.h"

#include <string.h>

enum {
    WIDTH = DLGMD_WIDTH,
    HEIGHT = DLGMD_HEIGHT,
    CELLS = DLGMD_WIDTH * DLGMD_HEIGHT,
    EARLIER = DLGMD_EARLIER,
    RADIUS = DLGMD_RADIUS,
    ROWS = DLGMD_ROWS,
    DELAYS = DLGMD_MAX_DELAY + 1
};

#include "dlgmd_model.h"

#if DLGMD_FIXED
typedef uint32_t number;
typedef uint64_t total; /* 64 bits are used per row or per frame, never per cell */
#else
typedef float number;
typedef float total;
#endif

/* Sums over the rows so far: G, which is K in the end, and G times its column and its row. */
typedef struct {
    total g;
    total g_column;
    total g_row;
} totals;

#if DLGMD_EXPANSION
/* The square and the narrow window around the usual heading. */
static const dlgmd_window usual_windows[2] = WINDOWS;
#endif

void dlgmd_reset(dlgmd_state *state)
{
    memset(state, 0, sizeof *state);
#if DLGMD_EXPANSION
    memcpy(state->windows, usual_windows, sizeof usual_windows);
#endif
}

static uint8_t distance(uint8_t a, uint8_t b)
{
    return (uint8_t)(a < b ? b - a : a - b);
}

/* The frame so many before this one; that EARLIER before is the oldest, whose place this one takes. */
static uint8_t *frame_before(dlgmd_state *state, uint32_t n_ago)
{
    return state->frames[(state->frame + EARLIER - n_ago) % EARLIER];
}

/* Row `at` of the ring. */
static uint8_t *ring_row(dlgmd_state *state, int at)
{
    return state->change + DLGMD_MARGIN + at * DLGMD_STRIDE;
}

/* Store row `y` and its change, zeros below the frame, and return the sum of the latter. */
static uint32_t see_row(dlgmd_state *state, const uint8_t *frame, int y)
{
    int at = ((int)state->start + RADIUS + y) % ROWS;
    uint8_t *row = ring_row(state, at);
    uint32_t sum = 0;
    if (y < HEIGHT) {
        const uint8_t *now = frame + y * WIDTH;
        const uint8_t *before = frame_before(state, 1) + y * WIDTH;
        uint8_t *kept = frame_before(state, EARLIER) + y * WIDTH;
        for (int x = 0; x < WIDTH; x++) {
            row[x] = distance(now[x], before[x]);
            kept[x] = now[x];
            sum += row[x];
        }
    } else {
        memset(row, 0, WIDTH);
    }
    if (at < 2 * RADIUS) {
        memcpy(ring_row(state, at + ROWS), row, WIDTH);
    }
    return sum;
}

/* S of row `y`. */
static void sum_row(dlgmd_state *state, int y, dlgmd_sum *s)
{
    const uint8_t *sources[DELAYS]; /* of each frame, the first row that the kernels reach */
    for (int delay = 0; delay < DELAYS; delay++) {
        int at = (int)state->start + ROWS + y - delay * DLGMD_PERIOD;
        sources[delay] = ring_row(state, at % ROWS);
    }
    sum_columns(sources, state->work.rows.columns);
    sum_along(sources, state->work.rows.columns, s);
}

#if DLGMD_FIXED

/* Threshold of G. It and the next functions are in units of 1 / G_ONE. */
static number threshold_of(uint32_t ffi)
{
    uint64_t threshold = (uint64_t)ffi * T_DE >> T_DE_SHIFT;
    return threshold < T_DE_MAX ? (number)threshold : T_DE_MAX;
}

/* G, at most 1. */
static number product(number s, number ce)
{
    number g = ce < 65536 ? s * ce : s * (ce >> 4);
    if (ce >= 65536) {
        g = g < G_ONE >> 4 ? g << 4 : G_ONE;
    }
    return g < G_ONE ? g : G_ONE;
}

/* In 1/4096. */
static number rounded(number g)
{
    return (g + (G_ONE >> 13)) / (G_ONE >> 12);
}

#else

static number threshold_of(uint32_t ffi)
{
    number threshold = T_DE * (number)ffi;
    return threshold < T_DE_MAX ? threshold : T_DE_MAX;
}

static number product(number s, number ce)
{
    number g = GAIN * s * ce;
    return g < G_MAX ? g : G_MAX;
}

static number rounded(number g)
{
    return g;
}

#endif

/* G of row `y` - 2, from the last four rows of S. Ce is the sum of 4 x 4 cells of S. */
static void read_row(dlgmd_sum (*s)[WIDTH + 3], int y, number t_de, totals *sums)
{
    const dlgmd_sum *above = s[(y + 1) & 3], *here = s[(y + 2) & 3];
    const dlgmd_sum *below = s[(y + 3) & 3], *last = s[y & 3];
    number a, b = 0, c = 0, d = 0, row = 0, column = 0;
    for (int x = 0; x < WIDTH + 3; x++) {
        a = b;
        b = c;
        c = d;
        d = (number)above[x] + here[x] + below[x] + last[x];
        if (x >= 3 && here[x - 2] > 0) {
            number g = product(here[x - 2], a + b + c + d);
            if (g >= t_de) {
                g = rounded(g);
                row += g;
                column += g * (number)(x - 3);
            }
        }
    }
    sums->g += row;
    sums->g_column += column;
    sums->g_row += (total)row * (total)(y - 2);
}

/* Process a frame and sum G; false while the history is not full. */
static bool respond(dlgmd_state *state, const uint8_t *frame, totals *sums)
{
    bool valid = state->frame >= FIRST_VALID;
    uint32_t *ffi = state->change_sums;
    memmove(ffi + 1, ffi, DLGMD_FFI_DELAY * sizeof *ffi);
    number t_de = threshold_of(ffi[DLGMD_FFI_DELAY]);
    ffi[0] = 0;
    memset(&state->work.rows, 0, sizeof state->work.rows);
    dlgmd_sum(*s)[WIDTH + 3] = state->work.rows.s;
    for (int y = -RADIUS; y < HEIGHT; y++) {
        ffi[0] += see_row(state, frame, y + RADIUS);
        if (valid && y >= 0) {
            sum_row(state, y, s[y & 3] + 1);
            if (y >= 2) {
                read_row(s, y, t_de, sums);
            }
        }
    }
    for (int y = HEIGHT; valid && y < HEIGHT + 2; y++) {
        memset(s[y & 3], 0, sizeof s[0]);
        read_row(s, y, t_de, sums);
    }
    return valid;
}


#if DLGMD_FIXED || DLGMD_EXPANSION

/* a / b, rounded down, without the compiler's division of 64 bits; b is not 0. */
static uint64_t quotient(uint64_t a, uint64_t b)
{
    uint64_t found = 0;
    unsigned n = 1;
    for (; b <= a >> 1; n++) {
        b <<= 1;
    }
    for (; n > 0; n--) {
        bool fits = a >= b;
        a -= fits ? b : 0;
        found = found << 1 | fits;
        b >>= 1;
    }
    return found;
}

#endif

#if DLGMD_FIXED

/* The centroid of G along a side, (2 place + 1) / side - 1, in 1/32768. */
static int16_t centroid(total g_place, total g, int32_t side)
{
    for (; g_place >> 47 != 0; g_place >>= 1) {
        g >>= 1;
    }
    return (int16_t)(g > 0 ? ((int32_t)quotient(g_place << 16, g) + 32768) / side - 32768 : 0);
}

static void finish(dlgmd_answer *answer, const totals *sums)
{
    answer->mp = (uint32_t)sums->g;
    answer->mp_abs = (uint16_t)quotient(sums->g << 15, sums->g + KAPPA);
    answer->g_x = centroid(sums->g_column, sums->g, WIDTH);
    answer->g_y = centroid(sums->g_row, sums->g, HEIGHT);
}

#else

static void finish(dlgmd_answer *answer, const totals *sums)
{
    answer->mp = sums->g;
    answer->mp_abs = sums->g / (sums->g + KAPPA);
    if (sums->g > 0.0f) {
        answer->g_x = (2.0f * sums->g_column / sums->g + 1.0f) / WIDTH - 1.0f;
        answer->g_y = (2.0f * sums->g_row / sums->g + 1.0f) / HEIGHT - 1.0f;
    }
}

#endif

#if DLGMD_EXPANSION

#if DLGMD_WIDTH > 240 || DLGMD_SHORTER / DLGMD_FACTOR < 20 || !DLGMD_SEES
#error "The expansion cannot be measured in images of this size, by a camera with these angles."
#endif

enum {
    BLOCKS_Y = DLGMD_HEIGHT / 4,
    BLOCKS_X = DLGMD_WIDTH / 4,
    /* The image moves by so many blocks at most. */
    MOST_Y = BLOCKS_Y / 3 < MOST_BLOCKS ? BLOCKS_Y / 3 : MOST_BLOCKS,
    MOST_X = BLOCKS_X / 3 < MOST_BLOCKS ? BLOCKS_X / 3 : MOST_BLOCKS,
    FACTOR = DLGMD_FACTOR,
    SMALL_Y = DLGMD_HEIGHT / DLGMD_FACTOR,
    SMALL_X = DLGMD_WIDTH / DLGMD_FACTOR,
    SIDE = (SMALL_Y < SMALL_X ? SMALL_Y : SMALL_X) / 2,
    LONGEST = DLGMD_WINDOW_X < DLGMD_WINDOW_Y ? DLGMD_WINDOW_Y : DLGMD_WINDOW_X,
    LEAST_REACH = SIDE < 12 ? (SIDE + 1) / 2 : 6,
    LINE = DLGMD_WINDOW_X + 2, /* cells in a row of the earlier image that are kept */
    GRID_Y = DLGMD_GRID_Y,
    GRID_X = DLGMD_GRID_X,
    KEPT = DLGMD_KEPT
};

static int size_of(int a)
{
    return a < 0 ? -a : a;
}

/* An image to read. */
typedef struct {
    const uint8_t *cells;
#if DLGMD_EVENS
    const uint32_t *gains; /* of the rows, in 1/2^22, where the light flickers; else NULL */
    uint32_t ratio;        /* of the levels in the end, in 1/2^20; 0 if they stay */
    int rows[3];           /* which rows of blocks `state->lit` holds */
#endif
} image;

#if DLGMD_EVENS

static uint8_t lit(uint8_t cell, uint32_t gain)
{
    uint32_t level = (cell * gain + (1u << 21)) >> 22;
    return (uint8_t)(level < 255 ? level : 255);
}

/* The period of the light in frames, by the change of the rows after so many; 0 if it is steady. */
static uint32_t period_of(dlgmd_state *state)
{
    const uint16_t *newest = state->row_sums[state->frame % KEPT];
    uint32_t *usual = state->row_changes, period = 2;
    if (state->frame < KEPT - 1) {
        return 0;
    }
    state->n_changes += state->n_changes < 10;
    for (uint32_t k = 1; k < KEPT; k++) {
        const uint16_t *then = state->row_sums[(state->frame + KEPT - k) % KEPT];
        uint32_t change = 0;
        for (int y = 0; y < HEIGHT; y++) {
            change += (uint32_t)size_of(newest[y] - then[y]);
        }
        int64_t more = (int64_t)16 * change - usual[k];
        usual[k] = (uint32_t)(usual[k] + (more * (32768 / (int32_t)state->n_changes) >> 15));
        period = k > 1 && usual[k] < usual[period] ? k : period;
    }
    bool is_clear = (uint64_t)usual[period] * 5 < (uint64_t)usual[1] * 3;
    return is_clear && state->n_changes >= 5 && usual[1] > 16 * 3 * CELLS / 10 ? period : 0;
}

/* Find what the light makes of each row: its sum, relative to the mean over a period. */
static void see_light(dlgmd_state *state, const uint8_t *frame)
{
    uint16_t *sums = state->row_sums[state->frame % KEPT];
    for (int y = 0; y < HEIGHT; y++) {
        uint32_t sum = 0;
        for (int x = 0; x < WIDTH; x++) {
            sum += frame[y * WIDTH + x];
        }
        sums[y] = (uint16_t)sum;
    }
    uint32_t period = period_of(state), *gains = state->gains[state->frame % (EARLIER + 1)];
    gains[0] = 0;
    for (int y = 0; period > 0 && y < HEIGHT; y++) {
        uint64_t usual = period * WIDTH; /* a level more, of both */
        for (uint32_t k = 0; k < period; k++) {
            usual += state->row_sums[(state->frame + KEPT - k) % KEPT][y];
        }
        uint64_t gain = quotient(usual << 22, (uint64_t)period * (sums[y] + WIDTH));
        const uint32_t least = (7u << 22) / 10, most = (13u << 22) / 10;
        gain = gain < least ? least : gain < most ? gain : most;
        gains[y] = (uint32_t)gain;
    }
}

#endif

static image image_of(const dlgmd_state *state, const uint8_t *cells, uint32_t frame)
{
#if DLGMD_EVENS
    const uint32_t *gains = state->gains[frame % (EARLIER + 1)];
    return (image){cells, gains[0] > 0 ? gains : NULL, 0, {-1, -1, -1}};
#else
    (void)state;
    (void)frame;
    return (image){cells};
#endif
}


/* A mean as a fraction. */
typedef struct {
    uint64_t sum, of;
} fraction;

static bool is_less(fraction a, fraction b)
{
    return a.sum * b.of < b.sum * a.of;
}

/* Sums over whole blocks of 4 x 4 cells. */
static void see_blocks(uint16_t (*blocks)[BLOCKS_X], const image *from)
{
    for (int y = 0; y < BLOCKS_Y; y++) {
        for (int x = 0; x < BLOCKS_X; x++) {
            const uint8_t *cell = from->cells + 4 * y * WIDTH + 4 * x;
            uint32_t sum = 0;
            for (int i = 0; i < 4; i++, cell += WIDTH) {
#if DLGMD_EVENS
                if (from->gains != NULL) {
                    uint32_t gain = from->gains[4 * y + i];
                    sum += (uint32_t)lit(cell[0], gain) + lit(cell[1], gain);
                    sum += (uint32_t)lit(cell[2], gain) + lit(cell[3], gain);
                    continue;
                }
#endif
                sum += (uint32_t)cell[0] + cell[1] + cell[2] + cell[3];
            }
            blocks[y][x] = (uint16_t)sum;
        }
    }
}

/* Mean change of the blocks where both frames overlap, the earlier one moved. */
static fraction change_of_blocks(const dlgmd_state *state, int dy, int dx)
{
    fraction change = {0, 0};
    for (int y = dy > 0 ? dy : 0; y < BLOCKS_Y + (dy < 0 ? dy : 0); y++) {
        const uint16_t *now = state->work.blocks[1][y], *then = state->work.blocks[0][y - dy];
        uint32_t sum = 0;
        for (int x = dx > 0 ? dx : 0; x < BLOCKS_X + (dx < 0 ? dx : 0); x++) {
            sum += (uint32_t)size_of(now[x] - then[x - dx]);
        }
        change.sum += sum;
    }
    change.of = (uint64_t)((BLOCKS_Y - size_of(dy)) * (BLOCKS_X - size_of(dx)));
    return change;
}

/* Cells of a shift in blocks, by the change at one block less, there, and at one more: a parabola
   has its minimum at half of run / rise. */
static int cells_of(int blocks, fraction less, fraction here, fraction more)
{
    int64_t a = (int64_t)(less.sum * here.of * more.of), b = (int64_t)(here.sum * less.of * more.of);
    int64_t c = (int64_t)(more.sum * less.of * here.of), run = a - c, rise = (a > c ? a : c) - b;
    int cells = 4 * blocks;
    if (rise > 0 && here.sum > 0) {
        int part = -2;
        for (; part < 2 && 4 * run >= (2 * part + 1) * rise; part++) { /* halves go up */
        }
        cells += part;
    }
    return cells;
}

/* Sum of the cells of three blocks, one below the other. */
static uint32_t column_of(const uint8_t *const *blocks, int x)
{
    uint32_t sum = 0;
    for (int i = 0; i < FACTOR; i++) {
        for (int at = i * WIDTH + x * FACTOR; at < i * WIDTH + (x + 1) * FACTOR; at++) {
            sum += (uint32_t)blocks[0][at] + blocks[1][at] + blocks[2][at];
        }
    }
    return sum;
}

/* The cells of row `y` of blocks, of which those from `left` up to `right` are right. */
static const uint8_t *cells_at(dlgmd_state *state, image *from, int y, int left, int right)
{
    const uint8_t *cells = from->cells + y * FACTOR * WIDTH;
#if DLGMD_EVENS
    if (from->gains != NULL) {
        uint8_t *held = state->lit[y % 3];
        for (int i = 0; i < FACTOR && from->rows[y % 3] != y; i++) {
            uint32_t gain = from->gains[y * FACTOR + i];
            for (int at = i * WIDTH + left * FACTOR; at < i * WIDTH + right * FACTOR; at++) {
                held[at] = lit(cells[at], gain);
            }
        }
        from->rows[y % 3] = y;
        return held;
    }
#else
    (void)state;
    (void)left;
    (void)right;
#endif
    return cells;
}

/* A part of row `y` of the reduced image: means over blocks, and over 3 x 3 of those; at a border,
   the blocks next to it count twice. */
static void reduce(dlgmd_state *state, image *from, int y, int left, int right, uint8_t *row)
{
    const uint8_t *blocks[3];
    int first = left > 0 ? left - 1 : 0, last = right < SMALL_X ? right : SMALL_X - 1;
    for (int i = 0; i < 3; i++) {
        int at = y + i - 1;
        at = at < 0 ? 0 : at < SMALL_Y ? at : SMALL_Y - 1;
        blocks[i] = cells_at(state, from, at, first, last + 1);
    }
    const uint32_t of = 9 * FACTOR * FACTOR;
    uint32_t before = column_of(blocks, first), now = left > 0 ? column_of(blocks, left) : before;
    uint8_t *into = row;
    for (int x = left + 1; x <= last; x++) {
        uint32_t next = column_of(blocks, x);
        *into++ = (uint8_t)((before + now + next + of / 2) / of);
        before = now;
        now = next;
    }
    if (right == SMALL_X) {
        *into = (uint8_t)((before + 2 * now + of / 2) / of);
    }
#if DLGMD_EVENS
    const uint32_t ratio = from->ratio;
    for (int x = 0; ratio > 0 && x < right - left; x++) {
        uint32_t level = (row[x] * ratio + (1u << 19)) >> 20;
        row[x] = (uint8_t)(level < 255 ? level : 255);
    }
#endif
}

typedef struct {
    number interval, fps;
} pace;

/* A step within the limits. */
static uint32_t limited(uint32_t step_us)
{
    return step_us < MIN_STEP_US ? MIN_STEP_US : step_us < MAX_STEP_US ? step_us : MAX_STEP_US;
}

#if DLGMD_FIXED

/* A difference in 1/32 of a grey level. */
typedef int32_t rest;
typedef int64_t moment;

/* Of a motion; of a variance; of a change. By how much sums are reduced, and half of the greatest rate
   per frame, so that their products have 64 bits. */
#define ONE (INT64_C(1) << 24)
#define MOMENT 256
#define CHANGE 16
#define SUMS (LONGEST < 16 ? 1 << 10 : LONGEST < 32 ? 1 << 14 : LONGEST < 64 ? 1 << 18 : 1 << 22)
#define MOST_GROWTH ONE

/* The time since the frame before, in 1/2^20 s, and its reciprocal, in 1/65536. */
static pace pace_of(uint32_t step_us)
{
    if (step_us == 0) {
        return (pace){USUAL_INTERVAL, USUAL_FPS};
    }
    step_us = limited(step_us);
    /* 2^20 / 10^6 is 1 + 759 / 15625; the quotient is found 8 bits at a time, in 32 bits. */
    uint32_t fps = (1000000u / step_us) << 16, left = (1000000u % step_us) << 8;
    fps += (left / step_us) << 8;
    fps += ((left % step_us) << 8) / step_us;
    return (pace){step_us + (759u * step_us + 7812u) / 15625u, fps};
}

/* Add the newest value to a mean that forgets at a rate per second in 1/65536: 1 - exp(-x) is the
   share of the newest; x is in 1/2^24. */
static void smooth(dlgmd_motion *mean, dlgmd_motion newest, pace passed, uint32_t rate)
{
    uint64_t x = (uint64_t)passed.interval * rate >> 12;
    unsigned n_halved = 0;
    for (; x > 1 << 20; x >>= 1) {
        n_halved++;
    }
    uint64_t share = x - (x * x >> 25) + ((uint32_t)(x * x >> 9) / 6 >> 15) * x / (1 << 24);
    for (; n_halved > 0; n_halved--) {
        share = 2 * share - (share * share >> 24);
    }
    *mean += (newest - *mean) * (int32_t)((share + 256) >> 9) >> 15;
}

/* A rate per frame as one per second, within limits, which widen with the mean. */
static dlgmd_motion per_second(dlgmd_motion rate, dlgmd_motion mean, pace passed)
{
    int64_t most = mean > 0 ? MAX_RATE + 2 * mean : MAX_RATE;
    most = (most < 31 * ONE ? most : 31 * ONE) * passed.interval >> 20; /* for 16 bits of answers */
    int64_t least = -((int64_t)MAX_RATE * passed.interval >> 20);
    return (rate < least ? least : rate < most ? rate : most) * passed.fps >> 16;
}

/* The middle of a side's cells, by the sum of its ends. */
static dlgmd_signed place_in(int ends, int side)
{
    return (dlgmd_signed)(ends * 32768 / side - 32768);
}

static dlgmd_signed told(dlgmd_motion rate)
{
    return (dlgmd_signed)(rate >> 14);
}

/* Time in 1/4096 s, by a rate in 1/65536. */
static void tell(dlgmd_answer *answer, dlgmd_motion rate, dlgmd_motion share)
{
    uint32_t part = (uint32_t)(share << 4);
    answer->has_ttc = rate >= LEAST_RATE && part > 0;
    if (answer->has_ttc) {
        answer->ttc_s = (dlgmd_positive)(part / (uint32_t)(rate >> 8));
    }
}

/* The root of a part of a whole. */
static dlgmd_motion root_of(moment part, moment whole)
{
    moment root = 0;
    for (; whole >> 31 != 0; whole >>= 1) {
        part >>= 1;
    }
    for (moment bit = 1 << 14; bit > 0; bit >>= 1) {
        root += (root + bit) * (root + bit) * whole <= part << 30 ? bit : 0;
    }
    return root << 9;
}

/* The share that a motion would explain of the change between images SHARE_INTERVAL apart: of those
   further apart, more is explained, as the square of the time, and no more is left. */
static dlgmd_motion share_between(dlgmd_motion share, number interval)
{
    if (interval <= SHARE_INTERVAL) {
        return share;
    }
    moment left = (ONE - share) * (ONE - share), near = (SHARE_INTERVAL << 12) / interval;
    return ONE - root_of(left, left + (ONE * ONE - left) / 65536 * (near * near) / 256);
}

static moment divided(moment a, moment b)
{
    int64_t size = (int64_t)quotient((uint64_t)(a < 0 ? -a : a), (uint64_t)b);
    return a < 0 ? -size : size;
}

/* What a cell at `offset` halves from the middle, at `from` halves, moves to. */
static dlgmd_place place_of(int from, int offset, dlgmd_motion shift, dlgmd_motion rate)
{
    return (dlgmd_place)(((int64_t)(from + offset) * 128) + ((shift + rate * offset / 2 + 32768) >> 16));
}

static int cell_of(dlgmd_place at)
{
    return at >> 8;
}

/* value / 2^bits, rounded */
static int32_t shifted(int32_t value, unsigned bits)
{
    return (value + (1 << (bits - 1))) >> bits;
}

/* How far a place is from the cell before it. */
static dlgmd_place beyond(dlgmd_place at)
{
    return at & 255;
}

/* What is between two cells, `part` of the way from the first one. */
static dlgmd_blend between(int32_t first, int32_t second, dlgmd_place part)
{
    return (dlgmd_blend)(256 * first + part * (second - first));
}

/* A cell less what is between two others. */
static rest rest_of(int32_t cell, dlgmd_blend left, dlgmd_blend right, dlgmd_place part)
{
    return shifted(65536 * cell - 256 * left - part * (right - left), 11);
}

static rest slope_in_levels(int32_t sobel)
{
    return 4 * sobel;
}

/* 1 / (1 + (apart / scale)^2), in 1/1024. */
static int32_t weight_of(rest apart, rest scale)
{
    for (; scale >= 512; scale /= 2) {
        apart /= 2; /* so that 32 bits are enough */
    }
    uint32_t square = (uint32_t)(scale * scale), both = square + (uint32_t)(apart * apart);
    return (int32_t)(((square << 10) + both / 2) / both);
}

/* One and a half times the mean difference, and a grey level. */
static rest scale_of(rest sum, int n)
{
    return 3 * sum / (2 * n) + 32;
}

/* Solve for the motion, which is added; of the sums, m[4][4] becomes what is left of the squares. The
   places in the sums are in halves of a cell. */
static void solve(moment m[5][5], dlgmd_motion *found)
{
    int64_t q[4];
    unsigned shift[4];
    for (int i = 0; i < 4; i++) {
        m[i][i] += (m[i][i] >> 20) + (i < 2 ? 1049 : 419430);
        for (shift[i] = 0; m[i][i] >> 2 * shift[i] >= INT64_C(1) << 30; shift[i]++) {
        }
    }
    for (int i = 0; i < 4; i++) {
        for (int j = 0; j < 4; j++) {
            m[i][j] >>= shift[i] + shift[j];
        }
        m[i][4] >>= shift[i];
        m[4][i] >>= shift[i];
    }
    for (int k = 0; k < 4; k++) {
        m[k][k] = m[k][k] > 256 ? m[k][k] : 256; /* but for rounding, it is */
        for (int i = k + 1; i < 5; i++) {
            int64_t factor = divided(m[i][k] * 65536, m[k][k]);
            for (int j = k; j < 5; j++) {
                m[i][j] -= factor * m[k][j] >> 16;
            }
        }
    }
    for (int k = 3; k >= 0; k--) {
        int64_t sum = m[k][4] * 65536;
        for (int j = k + 1; j < 4; j++) {
            sum -= m[k][j] * q[j];
        }
        q[k] = divided(sum, m[k][k]);
        found[k] += (k < 2 ? 256 * q[k] : 512 * q[k]) >> shift[k];
    }
}

#else

typedef float rest;
typedef float moment;

#define ONE 1.0f
#define MOMENT 1.0f
#define CHANGE 1.0f
#define SUMS 1.0f
#define MOST_GROWTH FLT_MAX

/* The time since the frame before in seconds, and its reciprocal. */
static pace pace_of(uint32_t step_us)
{
    float us = (float)limited(step_us);
    return step_us ? (pace){1e-6f * us, 1e6f / us} : (pace){USUAL_INTERVAL, USUAL_FPS};
}

/* Add the newest value to a mean that forgets at a rate per second: 1 - exp(-x) is the share of the
   newest. */
static void smooth(dlgmd_motion *mean, dlgmd_motion newest, pace passed, float rate)
{
    float x = passed.interval * rate;
    unsigned n_halved = 0;
    for (; x > 0.125f; x *= 0.5f) {
        n_halved++;
    }
    float share = x * (1.0f - x / 2.0f * (1.0f - x / 3.0f * (1.0f - x / 4.0f * (1.0f - x / 5.0f))));
    for (; n_halved > 0; n_halved--) {
        share *= 2.0f - share;
    }
    *mean += share * (newest - *mean);
}

/* A rate per frame as one per second, within limits, which widen with the mean. */
static dlgmd_motion per_second(dlgmd_motion rate, dlgmd_motion mean, pace passed)
{
    float most = mean > 0.0f ? MAX_RATE + 2.0f * mean : MAX_RATE;
    rate *= passed.fps;
    return rate < -MAX_RATE ? -MAX_RATE : rate < most ? rate : most;
}

/* The middle of a side's cells, by the sum of its ends. */
static dlgmd_signed place_in(int ends, int side)
{
    const float share = 1.0f / (float)side; /* a constant, which traps nowhere */
    return (float)ends * share - 1.0f;
}

static dlgmd_signed told(dlgmd_motion rate)
{
    return rate;
}

static void tell(dlgmd_answer *answer, dlgmd_motion rate, dlgmd_motion share)
{
    answer->has_ttc = rate >= LEAST_RATE && share > 0.0f;
    if (answer->has_ttc) {
        answer->ttc_s = share / rate;
    }
}

/* The root of a part of a whole. */
static dlgmd_motion root_of(moment part, moment whole)
{
    float root = 1.0f;
    for (int i = 0; i < 16; i++) {
        root = (root + part / whole / root) / 2.0f;
    }
    return root;
}

/* The share that a motion would explain of the change between images SHARE_INTERVAL apart: of those
   further apart, more is explained, as the square of the time, and no more is left. */
static dlgmd_motion share_between(dlgmd_motion share, number interval)
{
    if (interval <= SHARE_INTERVAL) {
        return share;
    }
    float left = (ONE - share) * (ONE - share), near = SHARE_INTERVAL / interval;
    return ONE - root_of(left, left + near * near * (ONE - left));
}

static moment divided(moment a, moment b)
{
    return a / b;
}

static dlgmd_place place_of(int from, int offset, dlgmd_motion shift, dlgmd_motion rate)
{
    return 0.5f * (float)from + shift + (1.0f + rate) * (0.5f * (float)offset);
}

static int cell_of(dlgmd_place at)
{
    return (int)at;
}

/* How far a place is from the cell before it. */
static dlgmd_place beyond(dlgmd_place at)
{
    int cell = cell_of(at);
    return at - (float)cell;
}

/* What is between two cells, `part` of the way from the first one. */
static dlgmd_blend between(int32_t first, int32_t second, dlgmd_place part)
{
    return (float)first + part * (float)(second - first);
}

/* A cell less what is between two others, in grey levels. */
static rest rest_of(int32_t cell, dlgmd_blend left, dlgmd_blend right, dlgmd_place part)
{
    return (float)cell - left - part * (right - left);
}

static rest slope_in_levels(int32_t sobel)
{
    return 0.125f * (float)sobel;
}

/* 1 / (1 + (apart / scale)^2) */
static float weight_of(rest apart, rest scale)
{
    return scale * scale / (scale * scale + apart * apart);
}

/* One and a half times the mean difference, and a grey level. */
static rest scale_of(rest sum, int n)
{
    return 1.5f * sum / (float)n + 1.0f;
}

/* Solve for the motion, which is added; of the sums, m[4][4] becomes what is left of the squares. The
   places in the sums are in halves of a cell. */
static void solve(moment m[5][5], dlgmd_motion *found)
{
    float q[4];
    for (int i = 0; i < 4; i++) {
        m[i][i] += 1e-6f * m[i][i] + (i < 2 ? 1e-3f : 0.4f);
    }
    for (int k = 0; k < 4; k++) {
        for (int i = k + 1; i < 5; i++) {
            float factor = m[i][k] / m[k][k];
            for (int j = k; j < 5; j++) {
                m[i][j] -= factor * m[k][j];
            }
        }
    }
    for (int k = 3; k >= 0; k--) {
        float sum = m[k][4];
        for (int j = k + 1; j < 4; j++) {
            sum -= m[k][j] * q[j];
        }
        q[k] = sum / m[k][k];
        found[k] += k < 2 ? q[k] : 2.0f * q[k];
    }
}

#endif

/* Whether a place is between cells of a side of `n`. */
static bool is_within(dlgmd_place at, int n)
{
    return at >= 0 && cell_of(at) < n - 1;
}

/* Where the cells of a window have moved to, in a row of the image that are all or partly in it. */
static dlgmd_place row_of(dlgmd_window part, int y, const dlgmd_motion *by)
{
    int mid = part.top + part.bottom - 1;
    return place_of(mid, 2 * y - mid, by[0], by[2]);
}

/* Keep the differences between a row of the window and where it has moved to, `line`; returns their
   sum. */
static rest see_row_of(dlgmd_state *state, dlgmd_window part, int y, int *n_seen)
{
    const uint8_t *here = state->work.fit.before[y - part.top + 1] + 1;
    const int16_t *cells = state->work.fit.cells;
    dlgmd_rest *rests = state->work.fit.rests[y - part.top];
    rest sum = 0;
    int n = 0;
    for (int x = 0; x < part.right - part.left; x++) {
        if (cells[x] >= 0) {
            const dlgmd_blend *line = state->work.fit.line + cells[x];
            rest apart = rest_of(here[x], line[0], line[1], state->work.fit.parts[x]);
            rests[x] = (dlgmd_rest)apart;
            sum += apart < 0 ? -apart : apart;
            n++;
        }
    }
    *n_seen += n;
    return sum;
}

/* Keep the differences between a window of the earlier image and where it has moved to, and find
   their scale. Returns how many cells are seen, or 0 if that is too little of it. */
static int see_rests(dlgmd_state *state, image now, dlgmd_window part, const dlgmd_motion *by,
                     rest *scale)
{
    int from = SMALL_X, to = 0, mid = part.left + part.right - 1;
    for (int x = part.left; x < part.right; x++) {
        dlgmd_place at = place_of(mid, 2 * x - mid, by[1], by[3]);
        int cell = is_within(at, SMALL_X) ? cell_of(at) : -1;
        state->work.fit.cells[x - part.left] = (int16_t)cell;
        if (cell >= 0) {
            state->work.fit.parts[x - part.left] = beyond(at);
            from = cell < from ? cell : from;
            to = cell + 2 > to ? cell + 2 : to;
        }
    }
    rest sum = 0;
    int n_seen = 0, held[2] = {-1, -1}; /* rows of the newest image */
    for (int y = part.top; from < to && y < part.bottom; y++) {
        dlgmd_place at_y = row_of(part, y, by);
        if (!is_within(at_y, SMALL_Y)) {
            continue;
        }
        for (int row = cell_of(at_y); row <= cell_of(at_y) + 1; row++) {
            if (held[row % 2] != row) {
                reduce(state, &now, row, from, to, state->work.fit.now[row % 2] + from);
                held[row % 2] = row;
            }
        }
        const uint8_t *above = state->work.fit.now[cell_of(at_y) % 2];
        const uint8_t *below = state->work.fit.now[(cell_of(at_y) + 1) % 2];
        for (int x = from; x < to; x++) {
            state->work.fit.line[x] = between(above[x], below[x], beyond(at_y));
        }
        sum += see_row_of(state, part, y, &n_seen);
    }
    *scale = n_seen ? scale_of(sum, n_seen) : 0;
    return 4 * n_seen >= (part.bottom - part.top) * (part.right - part.left) ? n_seen : 0;
}

/* Add the products of the slopes of row `y`, and of the differences, to the sums. */
static void add_row(const dlgmd_state *state, dlgmd_window part, int y, rest scale, moment m[5][5])
{
    const uint8_t *up = state->work.fit.before[y - part.top], *here = up + LINE, *down = here + LINE;
    const int16_t *cells = state->work.fit.cells;
    const dlgmd_rest *rests = state->work.fit.rests[y - part.top];
    moment yy = 0, yx = 0, xx = 0, yxx = 0, xxx = 0, xxxx = 0, ry = 0, rx = 0, rxx = 0;
    moment rr = 0;
    rest place_x = (rest)(part.left - part.right - 1);
    /* Of the columns before, here and after: their weighted sum, and how much they rise. */
    int32_t sum = 0, next_sum = 0, rise = 0, next_rise = 0;
    for (int x = -2; x < part.right - part.left; x++) {
        int32_t last_sum = sum, last_rise = rise;
        sum = next_sum;
        rise = next_rise;
        next_sum = up[x + 2] + 2 * here[x + 2] + down[x + 2];
        next_rise = down[x + 2] - up[x + 2];
        if (x < 0) {
            continue;
        }
        place_x += 2;
        if (cells[x] < 0) {
            continue;
        }
        rest g_x = slope_in_levels(next_sum - last_sum);
        rest g_y = slope_in_levels(last_rise + 2 * rise + next_rise), apart = rests[x];
        rest weight = weight_of(apart, scale), g_xx = g_x * place_x;
        rest w_x = weight * g_x, w_y = weight * g_y, w_xx = weight * g_xx;
        yy += (moment)w_y * g_y;
        yx += (moment)w_y * g_x;
        xx += (moment)w_x * g_x;
        yxx += (moment)w_xx * g_y;
        xxx += (moment)w_xx * g_x;
        xxxx += (moment)w_xx * g_xx;
        ry += (moment)w_y * apart;
        rx += (moment)w_x * apart;
        rxx += (moment)w_xx * apart;
        rr += (moment)(weight * apart) * apart;
    }
    moment from = (moment)(2 * y - part.top - part.bottom + 1);
    const moment row[5][5] = {{yy, yx, from * yy, yxx, ry},
                              {0, xx, from * yx, xxx, rx},
                              {0, 0, from * from * yy, from * yxx, from * ry},
                              {0, 0, 0, xxxx, rxx},
                              {0, 0, 0, 0, rr}};
    for (int i = 0; i < 5; i++) {
        for (int j = i; j < 5; j++) {
            m[i][j] += row[i][j];
        }
    }
}

static dlgmd_motion lesser(dlgmd_motion a, dlgmd_motion b)
{
    return a < b ? a : b;
}

static dlgmd_motion magnitude(dlgmd_motion a)
{
    return a < 0 ? -a : a;
}

static dlgmd_motion within(dlgmd_motion a, dlgmd_motion most)
{
    return a < -most ? -most : lesser(a, most);
}

/* The share of the change that the rates explain, by the sums of squares over `n` cells: what is left,
   and those of the rates, with places in halves of a cell. Negative if nothing changes. */
static dlgmd_motion share_of(moment left, const moment *rates, int n, const dlgmd_motion *by)
{
    dlgmd_motion b = within(by[2] / 2, MOST_GROWTH), a = within(by[3] / 2, MOST_GROWTH);
    moment explained = (rates[0] / SUMS * b / ONE + rates[1] / SUMS * a / ONE) * b / ONE +
                       (rates[1] / SUMS * b / ONE + rates[2] / SUMS * a / ONE) * a / ONE;
    left = left > 0 ? left / SUMS : 0;
    moment whole = explained > 0 ? left + explained : left;
    return whole < LEAST_SQUARE * (moment)n / SUMS ? -ONE : ONE - root_of(left, whole);
}

/* The motion of a window of the earlier image: shift along y and x, and expansion along both. Returns
   what `share_of` does. */
static dlgmd_motion fit(dlgmd_state *state, const image *pair, dlgmd_window part, dlgmd_motion *by)
{
    image before = pair[0];
    dlgmd_motion share = -ONE;
    for (int y = part.top - 1; y <= part.bottom; y++) {
        uint8_t *row = state->work.fit.before[y - part.top + 1];
        reduce(state, &before, y, part.left - 1, part.right + 1, row);
    }
    for (int step = 0; step < 2; step++) {
        moment m[5][5] = {{0}};
        rest scale;
        int n_seen = see_rests(state, pair[1], part, by, &scale);
        if (n_seen == 0) {
            memset(by, 0, 4 * sizeof *by);
            return -ONE;
        }
        for (int y = part.top; y < part.bottom; y++) {
            if (is_within(row_of(part, y, by), SMALL_Y)) {
                add_row(state, part, y, scale, m);
            }
        }
        for (int i = 0; i < 5; i++) {
            for (int j = 0; j < i; j++) {
                m[i][j] = m[j][i];
            }
        }
        const moment rates[3] = {m[2][2], m[2][3], m[3][3]};
        solve(m, by);
        share = share_of(m[4][4], rates, n_seen, by);
    }
    return share;
}

/* Where the change spreads along a side of `n` cells; false if it spreads too far. */
static bool spread_of(moment mass, moment first, moment second, int n, int *at, int *reach)
{
    moment mid = divided(first * MOMENT, mass);
    moment square = divided(second * MOMENT, mass) - mid * mid / MOMENT;
    if (100 * square > 81 * SIDE * SIDE * (moment)MOMENT) {
        return false;
    }
    int cells = LEAST_REACH;
    while (2 * cells + 1 <= SIDE &&
           (moment)(100 * (2 * cells + 1) * (2 * cells + 1)) * MOMENT <= 1024 * square) {
        cells++;
    }
    moment place = divided(2 * first + mass, 2 * mass);
    int middle = (int)place;
    *reach = cells;
    *at = middle < cells + 1 ? cells + 1 : middle > n - 2 - cells ? n - 2 - cells : middle;
    return true;
}

/* Keep the change of the reduced image; the mean, in the unit of `rest`. */
static rest see_change(dlgmd_state *state, const image *pair)
{
    image before = pair[0], newest = pair[1];
    uint32_t sum = 0;
    for (int y = 0; y < SMALL_Y; y++) {
        reduce(state, &before, y, 0, SMALL_X, state->work.moving.change[y]);
    }
    for (int y = 0; y < SMALL_Y; y++) {
        uint8_t *now = state->work.moving.now, *change = state->work.moving.change[y];
        reduce(state, &newest, y, 0, SMALL_X, now);
        for (int x = 0; x < SMALL_X; x++) {
            change[x] = distance(now[x], change[x]);
            sum += change[x];
        }
    }
    return (rest)sum * CHANGE / (SMALL_Y * SMALL_X);
}

/* The window about what moves in front of a still background; false if that is not in one place. */
static bool find_moving(const dlgmd_state *state, rest mean, dlgmd_window *part)
{
    rest least = 3 * CHANGE + mean;
    int level = (int)(least / CHANGE); /* what changes by more is above */
    moment mass = 0, first[2] = {0, 0}, second[2] = {0, 0};
    int n_above = 0;
    for (int y = 0; y < SMALL_Y; y++) {
        const uint8_t *change = state->work.moving.change[y];
        rest row = 0;
        for (int x = 0; x < SMALL_X; x++) {
            if (change[x] > level) {
                rest above = (rest)change[x] * CHANGE - least;
                row += above;
                first[1] += (moment)above * (rest)x;
                second[1] += (moment)above * (rest)(x * x);
                n_above++;
            }
        }
        mass += (moment)row;
        first[0] += (moment)row * (rest)y;
        second[0] += (moment)row * (rest)(y * y);
    }
    int y, x, reach_y, reach_x;
    if (100 * mass < 19 * CHANGE * (SMALL_Y * SMALL_X) || 5 * n_above > 2 * SMALL_Y * SMALL_X ||
        !spread_of(mass, first[0], second[0], SMALL_Y, &y, &reach_y) ||
        !spread_of(mass, first[1], second[1], SMALL_X, &x, &reach_x)) {
        return false;
    }
    *part = (dlgmd_window){y - reach_y, y + reach_y + 1, x - reach_x, x + reach_x + 1};
    return true;
}

/* The expansion of what moves in front of a still background, about a point inside it; else 0. */
static dlgmd_motion approach(dlgmd_state *state, const image *pair)
{
    dlgmd_window part;
    dlgmd_motion by[4] = {0, 0, 0, 0};
    if (!find_moving(state, see_change(state, pair), &part)) {
        return 0;
    }
    fit(state, pair, part, by);
    dlgmd_motion reach_y = (dlgmd_motion)(part.bottom - part.top - 1) / 2;
    dlgmd_motion reach_x = (dlgmd_motion)(part.right - part.left - 1) / 2;
    dlgmd_motion rate = lesser(by[2], by[3]);
    if (rate <= 0 || magnitude(by[0]) >= by[2] * reach_y || magnitude(by[1]) >= by[3] * reach_x) {
        return 0;
    }
    state->place_x = place_in(part.left + part.right, SMALL_X);
    state->place_y = place_in(part.top + part.bottom, SMALL_Y);
    return rate;
}

/* By how much the image has moved, in cells, by `state->work.blocks`. */
static void follow(dlgmd_state *state, int *dy, int *dx)
{
    int y = 0, x = 0;
    fraction here = change_of_blocks(state, 0, 0);
    fraction last = change_of_blocks(state, state->blocks_y, state->blocks_x);
    if (is_less(last, here)) {
        y = state->blocks_y;
        x = state->blocks_x;
        here = last;
    }
    for (bool is_better = true; is_better;) {
        int from_y = y, from_x = x;
        is_better = false;
        for (int i = from_y - 1; i <= from_y + 1; i++) {
            for (int j = from_x - 1; j <= from_x + 1; j++) {
                if (size_of(i) > MOST_Y || size_of(j) > MOST_X) {
                    continue;
                }
                fraction change = change_of_blocks(state, i, j);
                if (is_less(change, here)) {
                    here = change;
                    y = i;
                    x = j;
                    is_better = true;
                }
            }
        }
    }
    state->blocks_y = y;
    state->blocks_x = x;
    *dy = cells_of(y, change_of_blocks(state, y - 1, x), here, change_of_blocks(state, y + 1, x));
    *dx = cells_of(x, change_of_blocks(state, y, x - 1), here, change_of_blocks(state, y, x + 1));
}

#if DLGMD_EVENS

/* Sums of a reduced image over 15 x 8 blocks, in 1/120 of a level; a cell may be in two of them. */
static void see_grid(dlgmd_state *state, image from, uint32_t (*sums)[GRID_X])
{
    uint32_t down = 0, low = SMALL_Y; /* what is left of the block, in 1/8 row */
    memset(sums, 0, sizeof *sums * (GRID_Y + 1));
    for (int y = 0; y < SMALL_Y; y++) {
        uint32_t across[GRID_X], sum = 0, right = 0, wide = SMALL_X;
        reduce(state, &from, y, 0, SMALL_X, state->work.grid.row);
        for (int x = 0; x < SMALL_X; x++) {
            uint32_t level = state->work.grid.row[x];
            if (wide > GRID_X) {
                sum += GRID_X * level;
                wide -= GRID_X;
            } else {
                across[right++] = sum + wide * level;
                sum = (GRID_X - wide) * level;
                wide += SMALL_X - GRID_X;
            }
        }
        uint32_t part = low < GRID_Y ? low : GRID_Y;
        for (int x = 0; x < GRID_X; x++) {
            sums[down][x] += part * across[x];
            sums[down + 1][x] += (GRID_Y - part) * across[x];
        }
        down += low <= GRID_Y;
        low = low > GRID_Y ? low - GRID_Y : low + SMALL_Y - GRID_Y;
    }
}

/* Whether the mean changes by 1/n; `one` is a sum that is a level. */
static bool is_step(uint64_t before, uint64_t now, uint64_t one, uint64_t n)
{
    before = before > one ? before : one;
    return n * (now < before ? before - now : now - before) >= before;
}

/* By how much the image is brighter, if three quarters of it are, or darker; else 0. */
static uint32_t step_of(dlgmd_state *state, const image *pair)
{
    const uint32_t level = SMALL_Y * SMALL_X;
    uint32_t(*before)[GRID_X] = state->work.grid.before, (*now)[GRID_X] = state->work.grid.now;
    uint32_t *sorted = state->work.grid.ratios, n = 0;
    uint64_t all_before = 0, all_now = 0;
    see_grid(state, pair[0], before);
    see_grid(state, pair[1], now);
    for (int i = 0; i < GRID_Y * GRID_X; i++) {
        uint32_t a = before[i / GRID_X][i % GRID_X], b = now[i / GRID_X][i % GRID_X], at = n++;
        uint32_t ratio = (uint32_t)quotient((uint64_t)(b + level) << 20, a + level);
        for (; at > 0 && sorted[at - 1] > ratio; at--) {
            sorted[at] = sorted[at - 1];
        }
        sorted[at] = ratio;
        all_before += a;
        all_now += b;
    }
    if (!is_step(all_before, all_now, 120 * level, 20)) {
        return 0;
    }
    /* Quartiles in 1/2^22, and the median. */
    uint32_t low = sorted[29] + 3 * sorted[30], high = 3 * sorted[89] + sorted[90];
    uint32_t middle = (sorted[59] + sorted[60]) / 2;
    bool is_alike = low > (21u << 22) / 20 || high <= (19u << 22) / 20;
    return !is_alike ? 0 : middle < (1u << 24) - 1 ? middle : (1u << 24) - 1;
}

/* Whether the image may be brighter or darker as a whole, by blocks: half of them are a bit. */
static bool may_step(const dlgmd_state *state)
{
    const uint16_t *before = state->work.blocks[0][0], *now = state->work.blocks[1][0];
    uint32_t all_before = 0, all_now = 0;
    int n_up = 0, n_down = 0;
    for (int i = 0; i < BLOCKS_Y * BLOCKS_X; i++) {
        n_up += 100u * (now[i] + 16u) >= 103u * (before[i] + 16u);
        n_down += 100u * (now[i] + 16u) <= 97u * (before[i] + 16u);
        all_before += before[i];
        all_now += now[i];
    }
    bool is_most = 2 * n_up >= BLOCKS_Y * BLOCKS_X || 2 * n_down >= BLOCKS_Y * BLOCKS_X;
    return is_most && is_step(all_before, all_now, 16 * BLOCKS_Y * BLOCKS_X, 22);
}

/* Make the earlier image as bright as the newest if the exposure has stepped. Not at the first step
   in a row, which is true: what is white in one of them spoils the fit. */
static bool even(dlgmd_state *state, image *pair)
{
    uint32_t ratio = may_step(state) ? step_of(state, pair) : 0;
    bool is_first = ratio > 0 && !state->has_stepped;
    state->has_stepped = ratio > 0;
    pair[0].ratio = is_first ? 0 : ratio;
    return is_first;
}

#else

static bool even(dlgmd_state *state, image *pair)
{
    (void)state;
    (void)pair;
    return false;
}

#endif

/* Add a rate between two images to a mean per second. `passed` is the time since the frame before, and
   since the one that is compared. One at a step of the exposure may hide an expansion, but not show
   one. */
static void add(dlgmd_motion *mean, dlgmd_motion rate, const pace *passed, number decay, bool is_step)
{
    rate = per_second(rate, *mean, passed[1]);
    smooth(mean, is_step ? lesser(rate, *mean) : rate, passed[0], decay);
}

/* How many frames ago the image was that is compared, the latest that is old enough, or the oldest that
   is kept; `age_us` is the time since the frame before, and becomes that since this one. */
static uint32_t n_ago_of(const dlgmd_state *state, uint32_t *age_us)
{
    uint32_t n_ago = 1;
    while (*age_us > 0 && *age_us < LEAST_US && n_ago < EARLIER && n_ago < state->frame) {
        uint32_t step_us = state->steps_us[(state->frame - n_ago) % EARLIER];
        *age_us += step_us > 0 ? limited(step_us) : LEAST_US;
        n_ago++;
    }
    return n_ago;
}

/* Add the expansion in both windows; whether nothing changes in the square. `start` is how far the
   image has moved. */
static bool see_windows(dlgmd_state *state, const image *pair, const dlgmd_motion *start,
                        const pace *passed, bool is_step)
{
    bool is_blank = false;
    for (int i = 0; i < 2; i++) {
        dlgmd_motion by[4] = {start[0], start[1], 0, 0};
        dlgmd_motion share = fit(state, pair, state->windows[i], by);
        dlgmd_motion rate = lesser(by[2], by[3]), apart = magnitude(by[2] - by[3]);
        add(&state->both[i], rate - apart / 2, passed, BOTH_RATE, is_step);
        if (i == 0) {
            is_blank = share < 0;
            if (!is_blank) {
                share = share_between(share, passed[1].interval);
                smooth(&state->share, share, passed[0], AHEAD_RATE);
            }
            add(&state->ahead, rate - apart / 4, passed, AHEAD_RATE, is_step);
        }
    }
    return is_blank;
}

/* Measure how fast the image expands. */
static void expand(dlgmd_state *state, const uint8_t *frame, uint32_t step_us, dlgmd_answer *answer)
{
    const dlgmd_window *windows = state->windows;
    uint32_t age_us = step_us > 0 ? limited(step_us) : 0, n_ago = n_ago_of(state, &age_us);
    pace passed[2] = {pace_of(step_us), pace_of(age_us)};
    image pair[2] = {
        image_of(state, frame_before(state, n_ago), state->frame + EARLIER + 1 - n_ago),
        image_of(state, frame, state->frame)};
    int dy, dx;
    see_blocks(state->work.blocks[0], &pair[0]);
    see_blocks(state->work.blocks[1], &pair[1]);
    follow(state, &dy, &dx);
    bool is_step = even(state, pair);
    dlgmd_motion start[2] = {(dlgmd_motion)dy * ONE / FACTOR, (dlgmd_motion)dx * ONE / FACTOR};
    bool is_blank = see_windows(state, pair, start, passed, is_step);
    bool is_still = state->blocks_y == 0 && state->blocks_x == 0;
    add(&state->beside, is_still ? approach(state, pair) : 0, passed, BESIDE_RATE, is_step);
    dlgmd_motion share = state->share > LEAST_SHARE ? state->share : LEAST_SHARE;
    dlgmd_motion rate = state->ahead;
    if (state->beside >= LEAST_RATE && state->beside * share / ONE > rate) {
        rate = state->beside; /* of a whole object */
        share = ONE;
        is_blank = false;
        answer->expansion_x = state->place_x;
        answer->expansion_y = state->place_y;
    } else {
        int across = windows[0].left + windows[0].right + windows[1].left + windows[1].right;
        int down = windows[0].top + windows[0].bottom + windows[1].top + windows[1].bottom;
        answer->expansion_x = place_in(across, 2 * SMALL_X);
        answer->expansion_y = place_in(down, 2 * SMALL_Y);
    }
    tell(answer, rate, is_blank ? 0 : share);
    rate = (WEIGHT_SQUARE * state->both[0] + WEIGHT_NARROW * state->both[1]) / WEIGHTS;
    answer->expansion = told(rate);
    answer->approach = told(state->beside);
    answer->alarm = DLGMD_RULE == DLGMD_TTC
                        ? answer->has_ttc && answer->ttc_s <= TTC_ALARM
                        : rate >= EXPANSION_ALARM || state->beside >= APPROACH_ALARM;
}

/* 1 - square / (n (n + 1)) (1 - square / ((n + 2) (n + 3)) (1 - ...)), in 1/2^30. */
static uint64_t series(uint64_t square, uint32_t n)
{
    uint64_t sum = UINT64_C(1) << 30;
    for (uint32_t k = n + 16; k > n; k -= 2) {
        sum = (UINT64_C(1) << 30) - (uint32_t)(square * sum >> 30) / ((k - 2) * (k - 1));
    }
    return sum;
}

/* The cell of a side of `n` that a direction, in 1/100 degree from the axis, is in. */
static int32_t cell_at(int32_t cdeg, int32_t n)
{
    uint64_t angle = (uint64_t)(cdeg < 0 ? -cdeg : cdeg);
    angle = (angle < 8900 ? angle : 8900) * UINT64_C(3070415691) >> 14; /* radians, in 1/2^30 */
    uint64_t square = angle * angle >> 30;
    int64_t tangent = (int64_t)quotient((angle * series(square, 2) >> 30) << 24, series(square, 1));
    int64_t from_axis = FOCAL * (cdeg < 0 ? -tangent : tangent);
    return (int32_t)((((int64_t)(n + 1) << 39) + from_axis) >> 40);
}

/* The part of a window, by its angles, that is in the image but for its border; false if that is too
   little. */
static bool find_window(const int32_t *angles, int32_t right_cdeg, int32_t up_cdeg,
                        dlgmd_window *part)
{
    int32_t y = -up_cdeg - angles[2];
    int32_t top = cell_at(y - angles[1] / 2, SMALL_Y), bottom = cell_at(y + angles[1] / 2, SMALL_Y);
    int32_t left = cell_at(right_cdeg - angles[0] / 2, SMALL_X);
    int32_t right = cell_at(right_cdeg + angles[0] / 2, SMALL_X);
    int64_t n_cells = (int64_t)(bottom - top) * (right - left);
    part->top = top > 1 ? top : 1;
    part->bottom = bottom < SMALL_Y - 1 ? bottom : SMALL_Y - 1;
    part->left = left > 1 ? left : 1;
    part->right = right < SMALL_X - 1 ? right : SMALL_X - 1;
    int64_t high = part->bottom - part->top, wide = part->right - part->left;
    return high > 0 && wide > 0 && 10 * high * wide >= LEAST_SHOWN * n_cells;
}

void dlgmd_heading(dlgmd_state *state, int32_t right_cdeg, int32_t up_cdeg)
{
    static const int32_t angles[2][3] = PARTS;
    dlgmd_window found[2];
    bool is_known = right_cdeg >= -9000 && right_cdeg <= 9000 && up_cdeg >= -9000 && up_cdeg <= 9000;
    for (int i = 0; i < 2 && is_known; i++) {
        is_known = find_window(angles[i], right_cdeg, up_cdeg, &found[i]);
    }
    memcpy(state->windows, is_known ? found : usual_windows, sizeof usual_windows);
}

#endif

dlgmd_answer dlgmd_step_us(dlgmd_state *state, const uint8_t *frame, uint32_t step_us)
{
    dlgmd_answer answer = {0};
    answer.ttc_s = DLGMD_NO_TTC;
    totals sums = {0};
    if (state->frame == 0) {
        memcpy(frame_before(state, 1), frame, CELLS);
    }
#if DLGMD_EVENS
    see_light(state, frame);
#endif
#if DLGMD_EXPANSION
    if (state->frame > 0) {
        expand(state, frame, step_us, &answer);
    }
    state->steps_us[state->frame % EARLIER] = step_us;
#else
    (void)step_us;
#endif
    answer.valid = respond(state, frame, &sums);
    state->frame++;
    state->start = (state->start + DLGMD_PERIOD) % ROWS;
    if (answer.valid) {
        finish(&answer, &sums);
        answer.spike = answer.mp_abs >= T_MP;
    }
    answer.rule = DLGMD_RULE;
#if DLGMD_RULE == DLGMD_SPIKES
    state->spikes = answer.spike ? state->spikes + 1 : 0;
    answer.alarm = state->spikes >= N_SP;
#endif
    return answer;
}
