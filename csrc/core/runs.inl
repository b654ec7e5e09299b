// Drawing the runs of a tile, nearer ones first. Read once per instruction set (each_isa.h).

namespace nmbg::NMBG_ISA {

// Depths of a tile that sees nothing yet. Slots beyond the image are as near as can be: nothing is drawn
// there.
template <class T>
NMBG_INLINE void clear(std::array<T, Tiling::pixels>& depth, const PixelBox& box, int stride) {
    constexpr T infinity = std::numeric_limits<T>::infinity();
    depth.fill(-infinity);
    for (int row = 0; row < box.y1 - box.y0; ++row)
        std::fill_n(depth.begin() + row * stride, box.x1 - box.x0, infinity);
}

// About as many runs are nearer as are farther: of a closed surface, the side that is seen.
NMBG_INLINE float about_median(std::span<const Run> runs) {
    constexpr std::size_t samples = 15;
    std::array<float, samples> nearest;
    for (std::size_t i = 0; i < samples; ++i)
        nearest[i] = runs[(2 * i + 1) * runs.size() / (2 * samples)].nearest;
    std::nth_element(nearest.begin(), nearest.begin() + samples / 2, nearest.end());
    return nearest[samples / 2];
}

// Calls draw(items) with eight items at a time: the nearer half of the runs, then those of the others that do
// not lie behind what all pixels of the tile see by then. An item may come twice. The runs are used up.
//   ask(item), fetch(items): ask for what draw() will read, a while and one call before it
//   deepest(): the greatest depth that a pixel of the tile sees
template <class Deepest, class Ask, class Fetch, class Draw>
NMBG_INLINE void front_to_back(std::span<Run> runs, const Deepest& deepest, const Ask& ask,
                               const Fetch& fetch, const Draw& draw) {
    if (runs.empty()) return;
    int32_t items[2][wide], singles[wide];
    int n = 0, now = 0;
    bool waiting = false;
    const auto take = [&]() NMBG_INLINE_LAMBDA {
        fetch(items[now]);
        now ^= 1;
        if (waiting) draw(items[now]);
        waiting = true;
    };
    const auto finish = [&] {
        if (n) {
            for (int i = 0; i < wide; ++i) items[now][i] = singles[i < n ? i : 0];
            take();
        }
        if (waiting) draw(items[now ^ 1]);
        n = 0, waiting = false;
    };
    const auto draw_some = [&](std::span<const Run> some) NMBG_INLINE_LAMBDA {
        for (const Run& run : some) ask(run.first());
        for (const Run& run : some) {
            if (run.single()) {
                singles[n++] = run.first();
                if (n < wide) continue;
                for (int i = 0; i < wide; ++i) items[now][i] = singles[i];
                n = 0;
            } else {
                for (int i = 0; i < wide; ++i) items[now][i] = run.first() + i;
            }
            take();
        }
    };

    // Sorted out without branches, which nothing could foresee where the order is random.
    constexpr std::size_t block = 64;
    Run kept[block];
    const float middle = about_median(runs);
    std::size_t far = 0;
    for (std::size_t begin = 0; begin < runs.size(); begin += block) {
        std::size_t near = 0;
        for (const Run run : runs.subspan(begin, std::min(block, runs.size() - begin))) {
            const bool nearer = run.nearest <= middle;
            kept[near] = run, runs[far] = run;
            near += nearer, far += !nearer;
        }
        draw_some({kept, near});
    }
    finish();
    const auto hidden = static_cast<float>(deepest());
    for (std::size_t begin = 0; begin < far; begin += block) {
        std::size_t seen = 0;
        for (const Run run : runs.subspan(begin, std::min(block, far - begin))) {
            kept[seen] = run;
            seen += !(run.nearest > hidden);
        }
        draw_some({kept, seen});
    }
    finish();
}

}  // namespace nmbg::NMBG_ISA
