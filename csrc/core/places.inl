// Placing eight items at a time, see places.h. Read once per instruction set (each_isa.h).

namespace nmbg::NMBG_ISA {

// The pixels of all boxes that are drawn.
NMBG_INLINE PixelBox around(const Box<i32x8>& box, const i32x8& drawn) {
    const i32x8 none = splat<i32x8>(std::numeric_limits<int32_t>::min());
    return {-greatest_in(select(drawn, -box.x0, none)), -greatest_in(select(drawn, -box.y0, none)),
            greatest_in(select(drawn, box.x1, none)), greatest_in(select(drawn, box.y1, none))};
}

// Writes the places of items i to i + 7.
//   box: pixels that they may cover; unknown: whether that is not known
//   missed(): whether they cover none for all that; nearest(): as in Places; asked where it matters, in this
//   order
template <class Missed, class Nearest>
NMBG_INLINE void store_places(const Box<i32x8>& box, const i32x8& unknown, const Missed& missed,
                              const Nearest& nearest, const Tiling& tiling, int i, Places& out) {
    out.drawn[i / wide] = 0;
    const i32x8 drawn = unknown | ((box.x0 < box.x1) & (box.y0 < box.y1));
    if (!any_of(drawn)) return;
    const i32x8 seen = drawn & (unknown | ~missed());
    const uint32_t bits = bits_of(seen);
    if (!bits) return;
    out.drawn[i / wide] = static_cast<uint8_t>(bits);
    const int down = tiling.log_height(), across = tiling.log_width(), columns = tiling.columns();
    const i32x8 first = (box.y0 >> down) * columns + (box.x0 >> across);
    const i32x8 last = ((box.y1 - 1) >> down) * columns + ((box.x1 - 1) >> across);
    const i32x8 tile = select(unknown | (first != last), splat<i32x8>(Places::several_tiles), first);
    store(tile, out.tile + i), store(nearest(), out.nearest + i);
    store(box.x0, out.x0 + i), store(box.y0, out.y0 + i);
    store(box.x1, out.x1 + i), store(box.y1, out.y1 + i);

    PixelBox& row = out.row[i / wide];
    if (std::popcount(bits) <= Places::few || any_of(unknown))
        row = {};
    else if (const int one = std::countr_zero(bits); tile[one] >= 0 && !any_of(seen & (tile != tile[one])))
        row = out.box(i + one);
    else
        row = around(box, seen);
}

}  // namespace nmbg::NMBG_ISA
