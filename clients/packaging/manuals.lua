-- pandoc's filter for manual pages: headings in capitals, and a table that is wider than a terminal
-- becomes a list: first the titles of its columns, then the first column as terms.

local widest_columns = 70

local function width(blocks)
  return utf8.len(pandoc.utils.stringify(blocks)) or 0
end

function Header(header)
  if header.level == 1 then
    return header:walk({ Str = function(str) return pandoc.Str(pandoc.text.upper(str.text)) end })
  end
end

function Table(wide)
  local simple = pandoc.utils.to_simple_table(wide)
  local total = 0
  for column = 1, #simple.headers do
    local most = width(simple.headers[column])
    for _, row in ipairs(simple.rows) do
      most = math.max(most, width(row[column]))
    end
    total = total + most + 3
  end
  if total <= widest_columns then
    simple.widths = pandoc.List(simple.widths):map(function() return 0 end)
    -- The page breaks before the table, never inside: tbl warns of a break next to a text block.
    local lines = pandoc.RawBlock("man", ".ne " .. 2 * #simple.rows + 4)
    return { lines, pandoc.utils.from_simple_table(simple) }
  end
  local titles = pandoc.List()
  for column, title in ipairs(simple.headers) do
    titles:extend(column > 1 and { pandoc.Str(","), pandoc.Space() } or {})
    titles:extend(pandoc.utils.blocks_to_inlines(title))
  end
  local items = {}
  for _, row in ipairs(simple.rows) do
    local told = pandoc.List()
    for column = 2, #row do
      if width(row[column]) > 0 then
        if #told > 0 then
          told:extend({ pandoc.Str(";"), pandoc.Space() })
        end
        if #row > 2 then
          told:extend(pandoc.utils.blocks_to_inlines(simple.headers[column]))
          told:extend({ pandoc.Str(":"), pandoc.Space() })
        end
        told:extend(pandoc.utils.blocks_to_inlines(row[column]))
      end
    end
    table.insert(items, { pandoc.utils.blocks_to_inlines(row[1]), { { pandoc.Plain(told) } } })
  end
  return { pandoc.Para({ pandoc.Emph(titles) }), pandoc.DefinitionList(items) }
end
