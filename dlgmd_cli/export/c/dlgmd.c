/* The model; see dlgmd.h. Its constants and sums are in dlgmd_model.h. */
#include "dlgmd.h"

#include <string.h>

enum {
    WIDTH = DLGMD_WIDTH,
    HEIGHT = DLGMD_HEIGHT,
    CELLS = DLGMD_WIDTH * DLGMD_HEIGHT,
    RADIUS = DLGMD_RADIUS,
    ROWS = DLGMD_ROWS,
    DELAYS = DLGMD_MAX_DELAY + 1
};

/* Where to read the change of a frame: the first row that the kernels reach. */
typedef struct {
    const uint8_t *change;
#if DLGMD_CONTRAST
    const dlgmd_change *passed; /* P' by change */
#endif
} source;

#include "dlgmd_model.h"

#if DLGMD_FIXED
typedef uint32_t number;
typedef uint64_t total; /* 64 bits are used per row or per frame, never per cell */
#else
typedef float number;
typedef float total;
#endif

/* Sums over the rows so far: G, and G times its column and its row. */
typedef struct {
    total g;
    total g_column;
    total g_row;
#if DLGMD_BALANCE
    total quadrants[4]; /* G of each: top left and right, bottom left and right */
#endif
    total mp; /* K, in the unit of `g` */
} totals;

void dlgmd_reset(dlgmd_state *state)
{
    memset(state, 0, sizeof *state);
}

static uint8_t distance(uint8_t a, uint8_t b)
{
    return (uint8_t)(a < b ? b - a : a - b);
}

/* Row `at` of the ring. */
static uint8_t *ring_row(dlgmd_state *state, int at)
{
    return state->change + DLGMD_MARGIN + at * DLGMD_STRIDE;
}

/* Store the change of row `y`, zeros below the frame, and return its sum. */
static uint32_t see_row(dlgmd_state *state, const uint8_t *frame, int y)
{
    int at = ((int)state->start + RADIUS + y) % ROWS;
    uint8_t *row = ring_row(state, at);
    uint32_t sum = 0;
    if (y < HEIGHT) {
        const uint8_t *now = frame + y * WIDTH;
        uint8_t *before = state->previous + y * WIDTH;
        for (int x = 0; x < WIDTH; x++) {
            row[x] = distance(now[x], before[x]);
            before[x] = now[x];
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
    source sources[DELAYS];
    for (int delay = 0; delay < DELAYS; delay++) {
        int at = (int)state->start + ROWS + y - delay * DLGMD_PERIOD;
        sources[delay].change = ring_row(state, at % ROWS);
#if DLGMD_CONTRAST
        sources[delay].passed = state->passed[(state->frame - (uint32_t)delay) % DELAYS];
#endif
    }
    sum_columns(sources, state->work.rows.columns);
    sum_along(sources, state->work.rows.columns, s);
}

#if DLGMD_SHIFT > 0

enum { BLOCKS_Y = DLGMD_HEIGHT / 4, BLOCKS_X = DLGMD_WIDTH / 4 };

static int size_of(int a)
{
    return a < 0 ? -a : a;
}

/* The smallest shift that is too large along a side of `n` blocks. */
static int limit_of(int n)
{
    return (n / 3 < DLGMD_SHIFT / 4 ? n / 3 : DLGMD_SHIFT / 4) + 1;
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
static void see_blocks(uint16_t (*blocks)[BLOCKS_X], const uint8_t *frame)
{
    memset(blocks, 0, BLOCKS_Y * sizeof *blocks);
    for (int y = 0; y < 4 * BLOCKS_Y; y++) {
        for (int x = 0; x < 4 * BLOCKS_X; x++) {
            blocks[y / 4][x / 4] = (uint16_t)(blocks[y / 4][x / 4] + frame[y * WIDTH + x]);
        }
    }
}

/* Mean change of the blocks where both frames overlap, the earlier one moved. */
static fraction change_of_blocks(const dlgmd_state *state, int dy, int dx)
{
    fraction change = {0, 0};
    for (int y = dy > 0 ? dy : 0; y < BLOCKS_Y + (dy < 0 ? dy : 0); y++) {
        const uint16_t *now = state->work.blocks[0][y], *then = state->work.blocks[1][y - dy];
        uint32_t sum = 0;
        for (int x = dx > 0 ? dx : 0; x < BLOCKS_X + (dx < 0 ? dx : 0); x++) {
            sum += (uint32_t)size_of(now[x] - then[x - dx]);
        }
        change.sum += sum;
    }
    change.of = (uint64_t)((BLOCKS_Y - size_of(dy)) * (BLOCKS_X - size_of(dx)));
    return change;
}

typedef struct {
    int64_t run, rise;
} slope;

/* Twice the distance, in blocks, from here to the least change, by the changes beside: run / rise. */
static slope slope_of(fraction less, fraction here, fraction more)
{
    int64_t a = (int64_t)(less.sum * here.of * more.of), b = (int64_t)(here.sum * less.of * more.of);
    int64_t c = (int64_t)(more.sum * less.of * here.of), rise = (a > c ? a : c) - b;
    if (rise <= 0 || here.sum == 0 || less.of == 0 || more.of == 0) {
        return (slope){0, 1};
    }
    return (slope){a - c > rise ? rise : a - c < -rise ? -rise : a - c, rise};
}

/* Cells of a shift in blocks, by the change at one block less, there, and at one more. */
static int cells_of(int blocks, fraction less, fraction here, fraction more)
{
    slope part = slope_of(less, here, more);
    return 4 * blocks + (int)((4 * part.run + 9 * part.rise) / (2 * part.rise)) - 4; /* halves go up */
}

#if DLGMD_EXPANDS

/* Quarters of the middle two thirds of the picture. */
enum { PART_Y = BLOCKS_Y / 3, PART_X = BLOCKS_X / 3 };

/* Mean change of the blocks of the part from `top` and `left` on that the earlier frame covers. */
static fraction change_of_part(const dlgmd_state *state, int top, int left, int dy, int dx)
{
    fraction change = {0, 0};
    for (int y = top; y < top + PART_Y; y++) {
        for (int x = left; x < left + PART_X; x++) {
            if (y >= dy && y < BLOCKS_Y + dy && x >= dx && x < BLOCKS_X + dx) {
                int now = state->work.blocks[0][y][x];
                change.sum += (uint64_t)size_of(now - state->work.blocks[1][y - dy][x - dx]);
                change.of++;
            }
        }
    }
    return change;
}

/* A shift by the change at one block less, there, and at one more: in blocks, or in 1/4096. */
static dlgmd_place place_of(int blocks, fraction less, fraction here, fraction more)
{
    slope part = slope_of(less, here, more);
#if DLGMD_FIXED
    return 4096 * blocks + (dlgmd_place)(2048 * part.run / part.rise);
#else
    return (float)blocks + 0.5f * (float)part.run / (float)part.rise;
#endif
}

/* The shift of a part, from that of the picture. */
static void follow_part(const dlgmd_state *state, int top, int left, dlgmd_place *to_y,
                        dlgmd_place *to_x)
{
    int most_y = limit_of(BLOCKS_Y), most_x = limit_of(BLOCKS_X);
    int y = state->blocks_y, x = state->blocks_x;
    fraction here = change_of_part(state, top, left, y, x), next;
    for (int step = -1; step <= 1; step += 2) {
        while (size_of(y + step) < most_y &&
               is_less(next = change_of_part(state, top, left, y + step, x), here)) {
            here = next;
            y += step;
        }
    }
    for (int step = -1; step <= 1; step += 2) {
        while (size_of(x + step) < most_x &&
               is_less(next = change_of_part(state, top, left, y, x + step), here)) {
            here = next;
            x += step;
        }
    }
    *to_y = place_of(y, change_of_part(state, top, left, y - 1, x), here,
                     change_of_part(state, top, left, y + 1, x));
    *to_x = place_of(x, change_of_part(state, top, left, y, x - 1), here,
                     change_of_part(state, top, left, y, x + 1));
}

/* The least of the picture's four expansions, times PART_X * PART_Y. */
static dlgmd_place expansion(const dlgmd_state *state)
{
    dlgmd_place y[4], x[4];
    for (int i = 0; i < 4; i++) {
        int top = BLOCKS_Y / 2 - (i < 2 ? PART_Y : 0), left = BLOCKS_X / 2 - (i % 2 ? 0 : PART_X);
        follow_part(state, top, left, &y[i], &x[i]);
    }
    dlgmd_place apart[4] = {(x[1] - x[0]) * PART_Y, (x[3] - x[2]) * PART_Y, (y[2] - y[0]) * PART_X,
                            (y[3] - y[1]) * PART_X};
    dlgmd_place least = apart[0];
    for (int i = 1; i < 4; i++) {
        least = apart[i] < least ? apart[i] : least;
    }
    return least;
}

#endif

/* By how much the picture has moved. */
static void follow(dlgmd_state *state, const uint8_t *frame, int *dy, int *dx)
{
    int most_y = limit_of(BLOCKS_Y), most_x = limit_of(BLOCKS_X), y = 0, x = 0;
    see_blocks(state->work.blocks[0], frame);
    see_blocks(state->work.blocks[1], state->previous);
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
                if (size_of(i) >= most_y || size_of(j) >= most_x) {
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
#if DLGMD_EXPANDS
    state->expansion = expansion(state);
#endif
}

/* Move a row by `dx`: `from` may be the row itself. */
static void move_row(uint8_t *row, const uint8_t *from, int dx)
{
    memmove(row + (dx > 0 ? dx : 0), from - (dx < 0 ? dx : 0), (size_t)(WIDTH - size_of(dx)));
}

/* Where the cells of a row enter that has moved by `dx`. */
static int entering(int dx)
{
    return dx > 0 ? 0 : WIDTH + dx;
}

/* Sum of the change where the picture, moved by dx and dy, overlaps with the frame. */
static uint32_t change_of(const uint8_t *before, const uint8_t *frame, int dx, int dy)
{
    uint32_t sum = 0;
    for (int y = dy > 0 ? dy : 0; y < HEIGHT + (dy < 0 ? dy : 0); y++) {
        const uint8_t *now = frame + y * WIDTH, *then = before + (y - dy) * WIDTH - dx;
        for (int x = dx > 0 ? dx : 0; x < WIDTH + (dx < 0 ? dx : 0); x++) {
            sum += distance(now[x], then[x]);
        }
    }
    return sum;
}

/* Move the frame before, and the change of earlier frames, along with the picture. */
static void align(dlgmd_state *state, const uint8_t *frame)
{
    int dy, dx;
    follow(state, frame, &dy, &dx);
    uint64_t moved = change_of(state->previous, frame, dx, dy);
    uint64_t cells = (uint64_t)(WIDTH - size_of(dx)) * (uint64_t)(HEIGHT - size_of(dy));
    uint64_t still = change_of(state->previous, frame, 0, 0);
    if (moved * CELLS * 20 >= still * cells * 19) {
        return; /* less than a twentieth of the change would be gone */
    }
    for (int i = 0; i < HEIGHT; i++) {
        int y = dy > 0 ? HEIGHT - 1 - i : i; /* no row is overwritten before it is read */
        bool is_known = y - dy >= 0 && y - dy < HEIGHT;
        uint8_t *row = state->previous + y * WIDTH;
        if (is_known) {
            move_row(row, row - dy * WIDTH, dx);
            memcpy(row + entering(dx), frame + y * WIDTH + entering(dx), (size_t)size_of(dx));
        } else {
            memcpy(row, frame + y * WIDTH, WIDTH);
        }
        for (int delay = 1; delay < DELAYS; delay++) {
            int first = (int)state->start + ROWS + RADIUS - delay * DLGMD_PERIOD;
            row = ring_row(state, (first + y) % ROWS);
            if (is_known) {
                move_row(row, ring_row(state, (first + y - dy) % ROWS), dx);
                memset(row + entering(dx), 0, (size_t)size_of(dx));
            } else {
                memset(row, 0, WIDTH);
            }
            if ((first + y) % ROWS < 2 * RADIUS) {
                memcpy(ring_row(state, (first + y) % ROWS + ROWS), row, WIDTH);
            }
        }
    }
}

#endif

#if DLGMD_CONTRAST

/* sqrt(n) * 2^shift, where `shift` is the largest that fits. */
static uint32_t root(uint64_t n, unsigned *shift)
{
    uint64_t found = 0;
    *shift = 0;
    if (n == 0) {
        return 0;
    }
    for (; n >> 62 == 0; n <<= 2) {
        ++*shift;
    }
    for (uint64_t bit = UINT64_C(1) << 62; bit != 0; bit >>= 2) {
        bool fits = n >= found + bit;
        n -= fits ? found + bit : 0;
        found = (found >> 1) + (fits ? bit : 0);
    }
    return (uint32_t)found;
}

#if DLGMD_FIXED

/* found / 2^shift / CELLS, in 1/65536 */
static number mean_of(uint32_t found, unsigned shift)
{
    return (number)((((uint64_t)found << 16) / CELLS) >> shift);
}

static number of_level(uint32_t level)
{
    return level << 16;
}

static number times(number value, number factor)
{
    return (number)((uint64_t)value * factor >> 16);
}

/* Running average; the weight of the newest value is in 1/32768. */
static total smoothed(total before, total newest, int32_t weight)
{
    return before + (total)((int64_t)(newest - before) * weight >> 15);
}

/* P': the change above `least`, in 1/128. */
static dlgmd_change passing(uint32_t level, number least)
{
    return (dlgmd_change)(of_level(level) > least ? (of_level(level) - least) >> 9 : 0);
}

/* Square of the share of G that is not inhibited, in 1/32768. */
static number uninhibited(total usual, total sum)
{
    total limit = usual * GROWTH >> 14;
    number share = sum <= limit ? 32768 : (number)((limit << 15) / sum);
    return share * share >> 15;
}

static dlgmd_sum threshold_of(number least)
{
    uint64_t threshold = (uint64_t)least << S_BITS >> 16;
    return threshold < INT32_MAX ? (dlgmd_sum)threshold : INT32_MAX;
}

static total scaled(total value, number share)
{
    return value * share >> 15;
}

#if DLGMD_BALANCE
static total both_of(total value)
{
    return value * BOTH >> 15;
}
#endif

#if DLGMD_ADAPTS
static total above_mean(total mean)
{
    return mean * C_M >> 16;
}
#endif

#if DLGMD_EXPANDS
/* K, the more the faster the picture expands. The ratio to D_0 is in 1/1024, from 1 to 8. */
static total expanding(total mp, dlgmd_place expansion)
{
    int64_t ratio = expansion > 0 ? (int64_t)expansion * EXPANSION >> 16 : 0;
    ratio = ratio < 1024 ? 1024 : ratio < 8192 ? ratio : 8192;
    return ((total)(ratio * ratio) * (mp + K_0) >> 20) - K_0;
}
#endif

#else

/* found / 2^shift / CELLS */
static number mean_of(uint32_t found, unsigned shift)
{
    number mean = (number)found / CELLS;
    for (; shift > 0; shift--) {
        mean *= 0.5f;
    }
    return mean;
}

static number of_level(uint32_t level)
{
    return (number)level;
}

static number times(number value, number factor)
{
    return value * factor;
}

/* Running average. */
static total smoothed(total before, total newest, float weight)
{
    return before + weight * (newest - before);
}

/* P': the change above `least`. */
static dlgmd_change passing(uint32_t level, number least)
{
    return of_level(level) > least ? of_level(level) - least : 0.0f;
}

/* Square of the share of G that is not inhibited. */
static number uninhibited(total usual, total sum)
{
    number limit = GROWTH * usual, share = sum <= limit ? 1.0f : limit / sum;
    return share * share;
}

static dlgmd_sum threshold_of(number least)
{
    return least;
}

static total scaled(total value, number share)
{
    return value * share;
}

#if DLGMD_BALANCE
static total both_of(total value)
{
    return value * BOTH;
}
#endif

#if DLGMD_ADAPTS
static total above_mean(total mean)
{
    return mean * C_M;
}
#endif

#if DLGMD_EXPANDS
/* K, the more the faster the picture expands. */
static total expanding(total mp, dlgmd_place expansion)
{
    float ratio = expansion * EXPANSION;
    ratio = ratio < 1.0f ? 1.0f : ratio < 8.0f ? ratio : 8.0f;
    return ratio * ratio * (mp + K_0) - K_0;
}
#endif

#endif

static number larger(number a, number b)
{
    return a > b ? a : b;
}

/* Standard deviation of the frame, in grey levels. */
static number deviation(const uint8_t *frame)
{
    int32_t sum = 0;
    uint32_t squares = 0;
    for (int i = 0; i < CELLS; i++) {
        int32_t level = frame[i] - 128;
        sum += level;
        squares += (uint32_t)(level * level);
    }
    unsigned shift;
    uint32_t found = root((uint64_t)squares * CELLS - (uint64_t)((int64_t)sum * sum), &shift);
    return mean_of(found, shift);
}

/* Histograms of the change. */
static void count_changes(dlgmd_state *state, const uint8_t *frame)
{
    const uint8_t *before = state->previous;
    memset(&state->work.counts, 0, sizeof state->work.counts);
    for (int i = 0; i < CELLS; i++) {
        state->work.counts.all[distance(frame[i], before[i])]++;
    }
    for (int y = 0; y < HEIGHT; y += QUARTILE_STEP) {
        for (int i = y * WIDTH; i < (y + 1) * WIDTH; i += QUARTILE_STEP) {
            state->work.counts.some[distance(frame[i], before[i])]++;
        }
    }
}

/* Lower quartile of the change, in grey levels. */
static uint32_t lower_quartile(const uint32_t *counts)
{
    uint32_t level = 0;
    for (uint32_t seen = counts[0]; seen <= QUARTILE_CELLS / 4; seen += counts[level]) {
        level++;
    }
    return level;
}

/* Compute P' by change, the threshold of S, and return the factor for G. */
static number see_contrast(dlgmd_state *state, const uint8_t *frame, dlgmd_sum *above)
{
    number newest = deviation(frame);
    if (state->frame == 0) {
        state->sigma = newest;
        return 0;
    }
    state->sigma = (number)smoothed(state->sigma, newest, W_SIGMA);
    count_changes(state, frame);
    newest = of_level(lower_quartile(state->work.counts.some));
    state->noise = state->frame == 1 ? newest : (number)smoothed(state->noise, newest, W_SIGMA);
    number least = larger(times(state->sigma, C_P), times(state->noise, C_N));
    least = larger(least, P_MIN);
    dlgmd_change *passed = state->passed[state->frame % DELAYS];
    total sum = 0;
    for (uint32_t level = 0; level < 256; level++) {
        passed[level] = passing(level, least);
        sum += (total)state->work.counts.all[level] * passed[level];
    }
    number share = uninhibited(state->usual, sum);
    state->usual = state->frame == 1 ? sum : smoothed(state->usual, sum, W_M);
    *above = threshold_of(larger(times(state->sigma, C_S), S_MIN));
    return share;
}

/* Count the active cells of row `y`. */
static void read_row(const dlgmd_sum *s, int y, dlgmd_sum above, totals *sums)
{
    number active = 0, column = 0;
#if DLGMD_BALANCE
    number left = 0;
#endif
    for (int x = 0; x < WIDTH; x++) {
        if (s[x] > above) {
            active += weights_x[x];
            column += weights_x[x] * (number)x;
        }
#if DLGMD_BALANCE
        if (x == (WIDTH - 1) / 2) {
            left = active;
        }
#endif
    }
    total row = (total)active * weights_y[y];
    sums->g += row;
    sums->g_column += (total)column * weights_y[y];
    sums->g_row += row * (total)y;
#if DLGMD_BALANCE
    /* A middle row or column belongs to both sides. */
    number right = active - left;
    if (WIDTH % 2 == 1 && s[WIDTH / 2] > above) {
        right += weights_x[WIDTH / 2];
    }
    for (int below = y < (HEIGHT + 1) / 2 ? 0 : 1; below <= (y < HEIGHT / 2 ? 0 : 1); below++) {
        sums->quadrants[2 * below] += (total)left * weights_y[y];
        sums->quadrants[2 * below + 1] += (total)right * weights_y[y];
    }
#endif
}

#if DLGMD_BALANCE

/* K by the two quadrants with the least G. */
static total weakest(const total *quadrants)
{
    total least = quadrants[0], second = quadrants[1];
    for (int i = 1; i < 4; i++) {
        total one = quadrants[i];
        if (i == 1 ? one <= least : one < least) {
            second = least;
            least = one;
        } else if (i == 1 || one < second) {
            second = one;
        }
    }
    return both_of(least + second);
}

#endif

#if DLGMD_ADAPTS

/* What of K exceeds its mean over the earlier frames. */
static total adapted(dlgmd_state *state, total mp)
{
    total before = state->frame == FIRST_VALID ? mp : state->mean;
    state->mean = smoothed(before, mp, W_MEAN);
    before = above_mean(before);
    return mp > before ? mp - before : 0;
}

#endif

/* Process a frame and sum G; false while the history is not full. */
static bool respond(dlgmd_state *state, const uint8_t *frame, totals *sums)
{
    dlgmd_sum above = 0;
#if DLGMD_SHIFT > 0
    if (state->frame > 0) {
        align(state, frame);
    }
#endif
    number share = see_contrast(state, frame, &above);
    bool valid = state->frame >= FIRST_VALID;
    memset(&state->work.rows, 0, sizeof state->work.rows);
    for (int y = -RADIUS; y < HEIGHT; y++) {
        see_row(state, frame, y + RADIUS);
        if (valid && y >= 0) {
            sum_row(state, y, state->work.rows.s);
            read_row(state->work.rows.s, y, above, sums);
        }
    }
#if DLGMD_BALANCE
    sums->mp = scaled(weakest(sums->quadrants), share);
#else
    sums->mp = scaled(sums->g, share);
#endif
#if DLGMD_ADAPTS
    if (valid) {
        sums->mp = adapted(state, sums->mp);
    }
#endif
#if DLGMD_EXPANDS
    sums->mp = expanding(sums->mp, state->expansion);
#endif
    sums->g = scaled(sums->g, share);
    sums->g_column = scaled(sums->g_column, share);
    sums->g_row = scaled(sums->g_row, share);
    return valid;
}

#else

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
    sums->mp = sums->g;
    return valid;
}

#endif

#if DLGMD_FIXED

/* The centroid of G along a side, (2 place + 1) / side - 1, in 1/32768. */
static int16_t centroid(total g_place, total g, int32_t side)
{
    for (; g_place >> 47 != 0; g_place >>= 1) {
        g >>= 1;
    }
    if (g == 0) {
        return 0;
    }
    return (int16_t)(((int64_t)((g_place << 16) / g) + 32768) / side - 32768);
}

static void finish(dlgmd_answer *answer, const totals *sums)
{
#if DLGMD_CONTRAST
    total mp = sums->mp * CELLS >> 20;
    answer->mp = mp < UINT32_MAX ? (uint32_t)mp : UINT32_MAX;
#else
    answer->mp = (uint32_t)sums->mp;
#endif
    answer->mp_abs = (uint16_t)((sums->mp << 15) / (sums->mp + KAPPA));
    answer->g_x = centroid(sums->g_column, sums->g, WIDTH);
    answer->g_y = centroid(sums->g_row, sums->g, HEIGHT);
}

#else

static void finish(dlgmd_answer *answer, const totals *sums)
{
    answer->mp = sums->mp;
    answer->mp_abs = sums->mp / (sums->mp + KAPPA);
    if (sums->g > 0.0f) {
        answer->g_x = (2.0f * sums->g_column / sums->g + 1.0f) / WIDTH - 1.0f;
        answer->g_y = (2.0f * sums->g_row / sums->g + 1.0f) / HEIGHT - 1.0f;
    }
}

#endif

dlgmd_answer dlgmd_step(dlgmd_state *state, const uint8_t *frame)
{
    dlgmd_answer answer = {0};
    totals sums = {0};
    if (state->frame == 0) {
        memcpy(state->previous, frame, CELLS);
    }
    answer.valid = respond(state, frame, &sums);
    state->frame++;
    state->start = (state->start + DLGMD_PERIOD) % ROWS;
    if (answer.valid) {
        finish(&answer, &sums);
        answer.spike = answer.mp_abs >= T_MP;
        state->spikes = answer.spike ? state->spikes + 1 : 0;
        answer.alarm = state->spikes >= N_SP;
    }
    return answer;
}
