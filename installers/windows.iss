; Installer for Windows, by Inno Setup 6, of the folder that `py dev.py app` makes.
;   py dev.py app
;   iscc /DVersion=0.1.0 installers\windows.iss
; It was run under wine, never on a real Windows. It needs no administrator: the program goes to the user's own folder.
#ifndef Version
  #error Name the version: iscc /DVersion=0.1.0 installers\windows.iss
#endif

[Setup]
AppId=PFWD
AppName=PFWD
AppVersion={#Version}
AppPublisher=The PFWD contributors
DefaultDirName={autopf}\PFWD
DefaultGroupName=PFWD
DisableProgramGroupPage=yes
PrivilegesRequired=lowest
ArchitecturesAllowed=x64compatible
ArchitecturesInstallIn64BitMode=x64compatible
ChangesEnvironment=yes
LicenseFile=..\LICENSE
OutputDir=..\dist
OutputBaseFilename=pfwd-{#Version}-windows
Compression=lzma2
SolidCompression=yes
UninstallDisplayName=PFWD {#Version}

[Tasks]
Name: path; Description: "Let the command pfwd be typed in any folder (adds it to PATH)"

[Files]
Source: "..\dist\pfwd\*"; DestDir: "{app}"; Flags: recursesubdirs ignoreversion

[Icons]
; A window that stays open: the first screen explains the commands.
Name: "{group}\PFWD"; Filename: "{cmd}"; Parameters: "/K ""{app}\pfwd.exe"""; WorkingDir: "{userdocs}"
Name: "{group}\PFWD demo"; Filename: "{app}\pfwd.exe"; Parameters: "demo"; WorkingDir: "{userdocs}"

[Code]
// Path without the entries that name a folder, and without empty ones.
function PathWithout(Path, Folder: string): string;
var
  Entry: string;
  Place: Integer;
begin
  Result := '';
  Path := Path + ';';
  while Path <> '' do
  begin
    Place := Pos(';', Path);
    Entry := Copy(Path, 1, Place - 1);
    Delete(Path, 1, Place);
    if (Entry <> '') and (CompareText(RemoveBackslashUnlessRoot(Entry), Folder) <> 0) then
    begin
      if Result <> '' then
        Result := Result + ';';
      Result := Result + Entry;
    end;
  end;
end;

// Adds the program's folder to the user's PATH as its last entry, or removes it.
procedure ChangePath(Add: Boolean);
var
  Path, Changed, Folder: string;
begin
  if not RegQueryStringValue(HKEY_CURRENT_USER, 'Environment', 'Path', Path) then
    Path := '';
  Folder := ExpandConstant('{app}');
  Changed := PathWithout(Path, Folder);
  if Add then
  begin
    if Changed <> '' then
      Changed := Changed + ';';
    Changed := Changed + Folder;
  end;
  if (Changed = '') and (Path <> '') then
    RegDeleteValue(HKEY_CURRENT_USER, 'Environment', 'Path')
  else if Changed <> Path then
    RegWriteExpandStringValue(HKEY_CURRENT_USER, 'Environment', 'Path', Changed);
end;

procedure CurStepChanged(CurStep: TSetupStep);
begin
  if (CurStep = ssPostInstall) and WizardIsTaskSelected('path') then
    ChangePath(True);
end;

procedure CurUninstallStepChanged(CurUninstallStep: TUninstallStep);
begin
  if CurUninstallStep = usUninstall then
    ChangePath(False);
end;
