#include "cam/cutter.h"

#include "design/core/errors.h"
#include "design/core/geometry.h"
#include "design/core/toml_table.h"

namespace lightmill {

namespace {

/// A number without which a cutter is not one.
double needed(TomlTable& table, std::string_view key, double least, double most) {
  if (!table.has(key)) throw InputError(table.complaint(key, "is missing; every cutter file gives it"));
  return table.number_in(key, 0, least, most);
}

std::vector<HolderPiece> read_holder(TomlTable& table, double length_mm) {
  std::vector<HolderPiece> holder;
  double reached = 0;
  for (const auto& row : table.number_rows("holder", 4)) {
    const HolderPiece piece{row[0], row[1], row[2], row[3]};
    if (piece.from_mm < reached || piece.to_mm <= piece.from_mm) {
      throw InputError(table.complaint("holder",
                                       "rows are [from, to, radius at from, radius at to] in mm above the tip; "
                                       "they must go upwards and not overlap"));
    }
    if (piece.from_radius_mm <= 0 || piece.to_radius_mm <= 0) {
      throw InputError(table.complaint("holder", "radii must be above 0"));
    }
    if (piece.to_mm > length_mm)
      throw InputError(table.complaint("holder", "must end at or below the gauge line, length_mm"));
    reached = piece.to_mm;
    holder.push_back(piece);
  }
  return holder;
}

}  // namespace

Cutter read_cutter(const std::filesystem::path& path) {
  TomlTable table = TomlTable::from_file(path);
  Cutter cutter;
  cutter.name = table.text("name", path.stem().string());
  if (!table.has("number"))
    throw InputError(table.complaint("number", "is missing; it is the place in the tool table"));
  cutter.number = table.integer_in("number", 0, 1, 999);
  cutter.diameter_mm = needed(table, "diameter_mm", 0.05, 100);
  cutter.corner_radius_mm = needed(table, "corner_radius_mm", 0, 50);
  if (cutter.corner_radius_mm > cutter.diameter_mm / 2 + 1e-9) {
    throw InputError(table.complaint("corner_radius_mm", "must be at most half of diameter_mm (equal: a ball)"));
  }
  cutter.edges = table.integer_in("edges", 2, 1, 12);
  cutter.length_mm = needed(table, "length_mm", 1, 500);
  cutter.flute_length_mm = needed(table, "flute_length_mm", 0.05, cutter.length_mm);
  if (cutter.flute_length_mm < cutter.corner_radius_mm) {
    throw InputError(table.complaint("flute_length_mm", "must reach above the rounded corner"));
  }
  cutter.taper_rad = table.number_in("taper_deg", 0, 0, 45) * kPi / 180;
  if (cutter.taper_rad > 0 && !cutter.is_ball()) throw InputError(table.complaint("taper_deg", "only balls may be tapered"));
  cutter.shank_diameter_mm = table.number_in("shank_diameter_mm", cutter.diameter_mm, 0.05, 100);
  if (cutter.taper_rad > 0 && cutter.flute_radius_mm(cutter.flute_length_mm) > cutter.shank_diameter_mm / 2 + 1e-9) {
    throw InputError(table.complaint("taper_deg", "the cone is wider than the shank where the flutes end; make one of them smaller"));
  }
  cutter.centre_cutting = table.boolean("centre_cutting", false);
  cutter.holder = read_holder(table, cutter.length_mm);
  cutter.spindle_rpm = needed(table, "spindle_rpm", 1, 200000);
  cutter.feed_per_tooth_mm = needed(table, "feed_per_tooth_mm", 1e-5, 5);
  cutter.plunge_feed_mm_per_s = needed(table, "plunge_feed_mm_per_min", 0.1, 100000) / 60;
  cutter.most_stepover_mm = table.number_in("most_stepover_mm", 0, 0, cutter.diameter_mm);
  cutter.slot_depth_mm = table.number_in("slot_depth_mm", 0, 0, 100);
  cutter.coolant = table.choice("coolant", "none", {"air", "mist", "none"});
  cutter.source = table.text("source", "untested on the machine");
  table.finish();
  return cutter;
}

}  // namespace lightmill
