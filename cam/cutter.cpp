#include "cam/cutter.h"

#include "design/core/errors.h"
#include "design/core/geometry.h"
#include "design/core/text.h"
#include "design/core/toml_table.h"

namespace lightmill {

namespace {

/// A number without which a cutter is not one.
double needed(TomlTable& table, std::string_view key, double least, double most) {
  if (!table.has(key)) throw InputError(table.complaint(key, "is missing; every cutter file gives it"));
  return table.number_in(key, 0, least, most);
}

/// Stacked cones: rows of [length, diameter below, diameter above], the lowest first, standing on `from_mm`.
std::vector<ToolPiece> read_sections(TomlTable& table, std::string_view key, double from_mm) {
  std::vector<ToolPiece> pieces;
  for (const auto& row : table.number_rows(key, 3)) {
    if (!(row[0] > 0 && row[1] > 0 && row[2] > 0)) {
      throw InputError(table.complaint(key, "rows are [length, diameter below, diameter above] in mm, the lowest first, each above 0"));
    }
    pieces.push_back({from_mm, from_mm + row[0], row[1] / 2, row[2] / 2});
    from_mm += row[0];
  }
  return pieces;
}

void read_body(TomlTable& table, Cutter& cutter) {
  cutter.shank_diameter_mm = table.number_in("shank_diameter_mm", cutter.diameter_mm, 0.05, 100);
  cutter.shank = read_sections(table, "shank", cutter.flute_length_mm);
  const double above = cutter.shank.empty() ? cutter.shank_diameter_mm / 2 : cutter.shank.front().from_radius_mm;
  if (cutter.taper_rad > 0 && cutter.flute_radius_mm(cutter.flute_length_mm) > above + 1e-9) {
    throw InputError(table.complaint("taper_deg", "the cone is wider than the shank where the flutes end; make one of them smaller"));
  }
  // The holder hangs from the gauge line.
  cutter.holder = read_sections(table, "holder", 0);
  const double hangs = cutter.holder.empty() ? 0 : cutter.length_mm - cutter.holder.back().to_mm;
  for (ToolPiece& piece : cutter.holder) {
    piece.from_mm += hangs;
    piece.to_mm += hangs;
  }
  if (cutter.reach_mm() < cutter.flute_length_mm) {
    throw InputError(table.complaint("holder", "leaves " + compact(cutter.reach_mm(), 3) + " mm between the tip and itself, less than flute_length_mm; its sections hang from the gauge line, length_mm"));
  }
  if (!cutter.shank.empty() && cutter.shank.back().to_mm > cutter.reach_mm() + 1e-9) {
    throw InputError(table.complaint("shank", "its sections stand on the flutes and end " + compact(cutter.shank.back().to_mm - cutter.reach_mm(), 3) + " mm inside the holder"));
  }
}

void read_cutting_data(TomlTable& table, Cutter& cutter) {
  cutter.spindle_rpm = needed(table, "spindle_rpm", 1, 200000);
  cutter.feed_per_tooth_mm = needed(table, "feed_per_tooth_mm", 1e-5, 5);
  cutter.plunge_feed_mm_per_s = needed(table, "plunge_feed_mm_per_min", 0.1, 100000) / 60;
  cutter.most_stepover_mm = table.number_in("most_stepover_mm", 0, 0, cutter.diameter_mm);
  cutter.slot_depth_mm = table.number_in("slot_depth_mm", 0, 0, 100);
  cutter.coolant = table.choice("coolant", "none", {"air", "mist", "none"});
  cutter.source = table.text("source", "untested on the machine");
}

}  // namespace

std::string material_name(std::string_view description) { return std::string(description.substr(0, description.find_first_of(" ,;"))); }

Cutter read_cutter(const std::filesystem::path& path, std::string_view material) {
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
  cutter.centre_cutting = table.boolean("centre_cutting", false);
  read_body(table, cutter);
  if (!table.has("material")) {
    read_cutting_data(table, cutter);
    table.finish();
    return cutter;
  }
  TomlTable materials = table.table("material");
  std::string known;
  Cutter chosen;
  bool found = false;
  for (const std::string& name : materials.keys()) {
    TomlTable data = materials.table(name);
    Cutter with = cutter;
    read_cutting_data(data, with);
    known += (known.empty() ? "" : ", ") + name;
    if (found || !(material.empty() || name == material)) continue;
    found = true;
    chosen = with;
  }
  table.finish();
  if (!found) {
    throw InputError(path.string() + ": has no cutting data for the material '" + std::string(material) + "', only for " + known +
                     "; add a table [material." + std::string(material) + "] or take another material (stock.material)");
  }
  return chosen;
}

}  // namespace lightmill
