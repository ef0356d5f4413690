#include "cli/html_page.h"

#include "design/core/markup.h"

namespace lightmill {
namespace {

constexpr const char* kStyle = R"(
:root { --ink: #1c2430; --soft: #5b6675; --line: #dde2e8; --ground: #f5f6f8; --good: #1d7a46; --bad: #b3261e; --maybe: #a15c00; }
* { box-sizing: border-box; }
body { margin: 0; font: 15px/1.5 "Segoe UI", "Helvetica Neue", "DejaVu Sans", Arial, sans-serif; color: var(--ink); background: var(--ground); }
main { max-width: 1240px; margin: 0 auto; padding: 28px 24px 60px; }
h1 { font-size: 28px; margin: 0; letter-spacing: -0.01em; }
h2 { font-size: 19px; margin: 38px 0 12px; }
p { margin: 6px 0; }
.soft { color: var(--soft); }
.verdict { margin: 18px 0 0; padding: 14px 18px; border-radius: 8px; background: #fff; border-left: 6px solid var(--soft); font-size: 17px; }
.verdict.good { border-color: var(--good); } .verdict.good b { color: var(--good); }
.verdict.bad { border-color: var(--bad); } .verdict.bad b { color: var(--bad); }
.pictures { display: grid; grid-template-columns: repeat(auto-fit, minmax(260px, 1fr)); gap: 14px; }
figure { margin: 0; background: #fff; border: 1px solid var(--line); border-radius: 8px; overflow: hidden; }
figure img { display: block; width: 100%; }
.light img { background: #000; image-rendering: auto; }
figcaption { padding: 9px 12px 11px; font-size: 13.5px; color: var(--soft); }
figcaption b { display: block; color: var(--ink); font-size: 15px; }
table { border-collapse: collapse; width: 100%; background: #fff; border: 1px solid var(--line); border-radius: 8px; }
th, td { text-align: left; padding: 7px 12px; border-bottom: 1px solid var(--line); vertical-align: top; }
th { font-size: 13px; color: var(--soft); font-weight: 600; }
tr:last-child td { border-bottom: 0; }
td.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
.group td { background: #eef1f4; font-weight: 600; }
.ok { color: var(--good); font-weight: 600; } .no { color: var(--bad); font-weight: 700; }
.legend { height: 14px; border-radius: 3px; margin: 10px 0 2px; background: linear-gradient(to right, #173d8c, #73a6d9, #f5f5f2, #e88f6b, #9e1724); }
svg { display: block; background: #fff; border: 1px solid var(--line); max-width: 100%; height: auto; margin: 12px 0; }
.ends { display: flex; justify-content: space-between; font-size: 13px; color: var(--soft); }
pre { overflow-x: auto; } ul { margin: 6px 0; padding-left: 22px; } li { margin: 4px 0; }
.warn { background: #fff8ec; border: 1px solid #f0d9b0; border-radius: 8px; padding: 10px 16px; }
code { font: 13px/1.4 "DejaVu Sans Mono", Consolas, monospace; background: #eef1f4; padding: 1px 5px; border-radius: 4px; }
@media print { body { background: #fff; } main { padding: 0; } figure, table { break-inside: avoid; } }
)";

}  // namespace

std::string html_page(const std::string& title, const std::string& body) {
  return "<!doctype html>\n<html lang=en><head><meta charset=utf-8><meta name=viewport content=\"width=device-width\">\n<title>" +
         escaped(title) + "</title>\n<style>" + kStyle + "</style></head><body><main>\n" + body + "</main></body></html>\n";
}

}  // namespace lightmill
