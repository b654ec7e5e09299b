// Placing eight items at a time, see places.h. Read once per instruction set (each_isa.h).

namespace nmbg::NMBG_ISA {

// Writes the places of items i to i + 7.
//   box: pixels that they may cover; unknown: whether that is not known
//   missed(): whether they cover none for all that; asked where it matters
template <class Missed>
NMBG_INLINE void store_places(const Box<i32x8>& box, const i32x8& unknown, const Missed& missed,
                              const Tiling& tiling, int i, Places& out) {
    out.drawn[i / wide] = 0;
    const i32x8 drawn = unknown | ((box.x0 < box.x1) & (box.y0 < box.y1));
    if (!any_of(drawn)) return;
    out.drawn[i / wide] = static_cast<uint8_t>(bits_of(drawn & (unknown | ~missed())));
    const int down = tiling.log_height(), across = tiling.log_width(), columns = tiling.columns();
    const i32x8 first = (box.y0 >> down) * columns + (box.x0 >> across);
    const i32x8 last = ((box.y1 - 1) >> down) * columns + ((box.x1 - 1) >> across);
    const i32x8 several = splat<i32x8>(Places::several_tiles);
    store(select(unknown | (first != last), several, first), out.tile + i);
    store(box.x0, out.x0 + i), store(box.y0, out.y0 + i);
    store(box.x1, out.x1 + i), store(box.y1, out.y1 + i);
}

}  // namespace nmbg::NMBG_ISA
